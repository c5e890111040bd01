"""The messages of the errors that the program raises, out of its sources, for docs/troubleshooting.md.

python -m tests.messages        writes the page's tables anew
"""

import ast
import math
import re
from collections.abc import Iterator
from functools import cache
from itertools import product
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "troubleshooting.md"
MARK = "<!-- by python -m tests.messages: do not edit below -->\n"
SYMPTOMS = {
    "A port does not open, or is taken away": ["PortError"],
    "A device does not answer": ["SilentError"],
    "A device's messages make no sense": ["ProtocolError", "CodecError"],
    "A device, its driver or the guard refuses": [
        "DeviceError",
        "RefusedError",
        "CommandError",
        "wrong",
        "GuardRefusal",
        "RejectedError",
    ],
    "A motion is stopped, a trial ends": [
        "_fail",
        "_refuse",
        "_stall",
        "_stalled",
        "Stalled",
        "Refused",
        "Failed",
    ],
    "A detector refuses its rest": ["BaselineRefused"],
    "What `check --connect` finds": ["Finding"],
    "A command line is refused": ["UsageError", "BadParameter"],
    "A profile, a class or a setting is refused": ["ProfileError", "KindError", "ValueError", "TypeError"],
    "A recording or a file of your own is refused": ["ReplayError", "MissingDataError", "UnfitStreamError"],
    "A run folder cannot be written or read": ["RunFolderError", "RecordingError"],
    "Several processes, a cluster": ["JobsError"],
}
"""Heading of the page -> what is raised, or called, with such a message."""
ADVICE = {
    "A device's messages make no sense": "What came is not of the device's protocol, or was altered on the way: a noisy"
    " cable, another baud rate, another device at this port, other firmware. `run.py check PROFILE --connect --ports`"
    " asks who is there.",
    "A device, its driver or the guard refuses": "Where the second column is empty, the message has the value and the"
    " limit that refuses it: change one of the two.",
    "A motion is stopped, a trial ends": "Where the second column is empty, look at the mover first, then at the last"
    " seconds of the trial's signals (`run.py open latest`). `run.py home PROFILE` leads it back under the guard.",
    "A command line is refused": "`run.py VERB --help` has the verb's options.",
    "A profile, a class or a setting is refused": "File, section and key stand before the message. Where the second"
    " column is empty, the message says what must hold.",
    "A recording or a file of your own is refused": "What is read, and how a column is named:"
    " [the input of a replay](reference/command_line.md#the-input-of-a-replay).",
}
"""What stands under a heading of the page, for messages without a remedy of their own."""
UNSEEN = {
    "_UntriedError",  # told as a finding
    "AssertionError",  # of the contract that `check` tries
    "AttributeError",  # of names that `touchbench` does not have
    "CanOperationError",  # as python-can raises them; told as a link's fault
    "EndlessError",  # of a campaign of the swarm, which is a violation
    "EOFError",  # of a program that `certify` kills: the reason in its table
    "ImportError",
    "KeyError",
    "OSError",
    "RuntimeError",
    "TimeoutError",
}
"""What is raised and caught again, or is a defect: no message of its own."""
STOPS = {("controller", "guard.py"), ("controller", "arrivals.py"), ("controller", "loop.py")}
"""Modules whose formatted texts say why the guard or the loop stops a trial."""
SILENT = {"codec.py", "compiling.py", "tool.py"}
"""Modules of drivers whose functions return texts that nobody is shown."""
ROOMS = ("run.py", "touchbench", "config", "controller", "behaviors", "drivers")


MOST = 12
"""How many texts one message may have; what would have more is told with … in place of its parts."""


def _templates(node: ast.expr, names: dict[str, list[ast.expr]]) -> list[str]:
    """The texts that an expression may be; what varies is …"""
    found = ["…"]
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        found = [node.value]
    elif isinstance(node, ast.JoinedStr):
        found = _joined([_templates(part, names) for part in node.values])
    elif isinstance(node, ast.FormattedValue):
        found = _templates(node.value, names)
    elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        found = _joined([_templates(node.left, names), _templates(node.right, names)])
    elif isinstance(node, ast.IfExp):
        found = _templates(node.body, names) + _templates(node.orelse, names)
    elif isinstance(node, ast.Name) and node.id in names:
        others = {name: values for name, values in names.items() if name != node.id}
        found = [text for value in names[node.id] for text in _templates(value, others)]
    return list(dict.fromkeys(found))


def _joined(parts: list[list[str]]) -> list[str]:
    """The texts that parts make one after the other."""
    if math.prod(map(len, parts)) > MOST:
        parts = [part if len(part) == 1 else ["…"] for part in parts]
    return ["".join(each) for each in product(*parts)]


Place = tuple[int, ...]
"""The blocks of a function that a statement stands in, from the outermost on."""


def _placed(body: list[ast.stmt], place: Place = ()) -> Iterator[tuple[ast.stmt, Place]]:
    """Each statement of a block, and of the blocks in it, with its place."""
    for statement in body:
        yield statement, (*place, id(body))
        for field in ("body", "orelse", "finalbody", "handlers", "cases"):
            for each in getattr(statement, field, ()):
                inner = each.body if isinstance(each, ast.ExceptHandler | ast.match_case) else None
                yield from _placed(inner, (*place, id(body))) if inner else ()
            inner = getattr(statement, field, ())
            if inner and isinstance(inner[0], ast.stmt):
                yield from _placed(inner, (*place, id(body)))


def _assigned(function: ast.FunctionDef) -> dict[str, list[tuple[Place, ast.expr]]]:
    """What a function sets each of its names to, and where."""
    found: dict[str, list[tuple[Place, ast.expr]]] = {}
    for node, place in _placed(function.body):
        if not isinstance(node, ast.Assign) or len(node.targets) != 1:
            continue
        target, value = node.targets[0], node.value
        pairs = [(target, value)]
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            pairs = list(zip(target.elts, value.elts, strict=False))
        for name, given in pairs:
            if isinstance(name, ast.Name):
                found.setdefault(name.id, []).append((place, given))
    return found


def _worlds(
    assigned: dict[str, list[tuple[Place, ast.expr]]], place: Place
) -> Iterator[dict[str, list[ast.expr]]]:
    """What the names stand for at a place, for each branch that may have led there."""
    near: dict[str, list[tuple[Place, ast.expr]]] = {}
    for name, values in assigned.items():
        known = [at for at, _ in values if place[: len(at)] == at]
        block = max(known, key=len, default=())
        near[name] = [(at, value) for at, value in values if at[: len(block)] == block]
    for branch in dict.fromkeys([at for values in near.values() for at, _ in values] or [place]):
        world = {}
        for name, values in near.items():
            there = [
                (at, value) for at, value in values if branch[: len(at)] == at or at[: len(branch)] == branch
            ]
            deepest = max((len(at) for at, _ in there if branch[: len(at)] == at), default=0)
            world[name] = [value for at, value in there if len(at) >= deepest] or [
                value for _, value in values
            ]
        yield world


@cache
def parsed(path: Path) -> ast.Module:
    """A source file; many are asked for again and again."""
    return ast.parse(path.read_text("utf-8"))


def _trees() -> list[tuple[Path, ast.Module]]:
    """The program's sources."""
    paths = [
        path
        for room in ROOMS
        for path in ([ROOT / room] if room.endswith(".py") else (ROOT / room).rglob("*.py"))
    ]
    return [(path, parsed(path)) for path in paths]


@cache
def messages() -> dict[str, set[tuple[str, str]]]:
    """Symptom -> reason and remedy of each message; what varies is …; a reason without a fixed word has no entry."""
    kinds = {name: symptom for symptom, names in SYMPTOMS.items() for name in names}
    found: dict[str, set[tuple[str, str]]] = {symptom: set() for symptom in SYMPTOMS}
    for path, tree in _trees():
        for function in ast.walk(tree):
            if not isinstance(function, ast.FunctionDef):
                continue
            assigned = _assigned(function)
            reports = path.relative_to(ROOT).parts[0] == "drivers" and path.name not in SILENT
            for statement, place in _placed(function.body):
                for names in _worlds(assigned, place):
                    for kind, said in _said(statement, names, reports, path.parts[-2:] in STOPS):
                        text = re.sub(r"…(?:…)+", "…", re.sub(r"\s+", " ", said).strip())
                        reason, _, remedy = text.replace("|", "\\|").partition("; ")
                        fixed = re.search(r"[a-z]{3}", text) and " " in text.strip("… ")
                        if kind in kinds and fixed and re.search(r"[a-z]", reason):
                            found[kinds[kind]].add((reason, remedy if re.search(r"\w", remedy) else ""))
    return found


def raised() -> set[str]:
    """The classes of which the program raises errors with a text."""
    found = set()
    for _, tree in _trees():
        for node in ast.walk(tree):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                found.add(ast.unparse(node.exc.func).rpartition(".")[2])
    return {name for name in found if name.endswith(("Error", "Refusal", "Parameter"))}


def _said(
    statement: ast.stmt, names: dict[str, list[ast.expr]], reports: bool, stops: bool
) -> Iterator[tuple[str, str]]:
    """As `_texts`, of a statement without the blocks in it."""
    waiting: list[ast.AST] = [statement]
    while waiting:
        node = waiting.pop()
        yield from _texts(node, names, reports, stops)
        inner = (ast.stmt, ast.ExceptHandler, ast.match_case)
        waiting += [each for each in ast.iter_child_nodes(node) if not isinstance(each, inner)]


def _texts(
    node: ast.AST, names: dict[str, list[ast.expr]], reports: bool, stops: bool
) -> Iterator[tuple[str, str]]:
    """What raises or reports, and its text.

    Args:
        node: Of the sources.
        names: What the names in the function stand for.
        reports: Whether what its functions return is reported.
        stops: Whether its formatted texts say why a trial ends.
    """
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
        kind = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
        given = [_templates(each, names) for each in node.args]
        if kind == "LinkError":
            yield from ((ast.unparse(node.args[0]), "; ".join(each)) for each in product(*given[1:]))
        elif kind.endswith(("Error", "wrong", "Refusal", "Parameter")):
            said = given[2:] if len(given) == 4 else given if len(given) == 1 else [[""]]
            yield from ((kind, "; ".join(each)) for each in product(*said))
        elif kind == "Finding":
            yield from ((kind, text) for text in given[1] if given[0] != ["ok"])
        elif given:
            kind = "Stalled" if stops and kind == "append" else kind
            yield from ((kind, text) for text in max(given, key=lambda texts: len(max(texts, key=len))))
    elif reports and isinstance(node, ast.Return) and isinstance(node.value, ast.Constant | ast.JoinedStr):
        yield from (("Stalled", text) for text in _templates(node.value, {}))
    elif stops and isinstance(node, ast.Tuple | ast.List | ast.Return):
        parts = [node.value] if isinstance(node, ast.Return) else node.elts
        texts = [text for part in parts if isinstance(part, ast.JoinedStr) for text in _templates(part, {})]
        yield from (("Stalled", text) for text in texts)


def tables() -> str:
    """The page's tables, in Markdown."""
    lines = []
    for symptom, entries in messages().items():
        advice = [ADVICE[symptom] + "\n"] if symptom in ADVICE else []
        lines += [f"\n### {symptom}\n", *advice, "| message | what to do |", "| --- | --- |"]
        lines += [f"| {reason} | {remedy} |".replace("<", "&lt;") for reason, remedy in sorted(entries)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(PAGE.read_text().partition(MARK)[0] + MARK + tables())
