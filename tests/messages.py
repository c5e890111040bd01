"""The messages of the errors that the program raises, out of its sources, for docs/troubleshooting.md.

python -m tests.messages        writes the page's tables anew
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "troubleshooting.md"
MARK = "<!-- by python -m tests.messages: do not edit below -->\n"
SYMPTOMS = {
    "A port does not open, or is taken away": ["PortError"],
    "A device does not answer": ["SilentError"],
    "A device's messages make no sense": ["ProtocolError", "CodecError"],
    "A device, its driver or the guard refuses": [
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
    "A profile, a class or a setting is refused": ["ProfileError", "KindError", "ValueError", "TypeError"],
    "A recording or a file of your own is refused": ["ReplayError", "MissingDataError", "UnfitStreamError"],
    "A run folder cannot be written or read": ["RunFolderError", "RecordingError"],
    "Several processes, a cluster": ["JobsError"],
}
"""Heading of the page -> what is raised, or called, with such a message."""
STOPS = {("controller", "guard.py"), ("controller", "arrivals.py"), ("controller", "loop.py")}
"""Modules whose formatted texts say why the guard or the loop stops a trial."""
SILENT = {"codec.py", "compiling.py", "tool.py"}
"""Modules of drivers whose functions return texts that nobody is shown."""
ROOMS = ("run.py", "touchbench", "config", "controller", "behaviors", "drivers")


def _template(node: ast.expr, names: dict[str, ast.expr]) -> str:
    """The text of an expression; what varies is …"""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(
            _template(part, names) if isinstance(part, ast.Constant) else "…" for part in node.values
        )
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _template(node.left, names) + _template(node.right, names)
    if isinstance(node, ast.Name) and node.id in names:
        return _template(names.pop(node.id), names)
    return "…"


def _assigned(function: ast.AST) -> dict[str, ast.expr]:
    """Names that a function sets once, to a text."""
    found: dict[str, list[ast.expr]] = {}
    for node in ast.walk(function):
        if isinstance(node, ast.Assign) and len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            found.setdefault(node.targets[0].id, []).append(node.value)
    return {name: values[0] for name, values in found.items() if len(values) == 1}


def messages() -> dict[str, set[tuple[str, str]]]:
    """Symptom -> reason and remedy of each message; what varies is …; without a fixed word there is no entry."""
    kinds = {name: symptom for symptom, names in SYMPTOMS.items() for name in names}
    found: dict[str, set[tuple[str, str]]] = {symptom: set() for symptom in SYMPTOMS}
    for room in ROOMS:
        for path in [ROOT / room] if room.endswith(".py") else (ROOT / room).rglob("*.py"):
            for function in ast.walk(ast.parse(path.read_text())):
                if not isinstance(function, ast.FunctionDef):
                    continue
                names = _assigned(function)
                reports = path.parts[-3] == "drivers" and path.name not in SILENT
                for node in ast.walk(function):
                    for kind, said in _texts(node, names, reports, path.parts[-2:] in STOPS):
                        text = re.sub(r"\s+", " ", said).strip().replace("|", "\\|")
                        if kind in kinds and re.search(r"[a-z]{3}", text) and " " in text.strip("… "):
                            reason, _, remedy = text.partition("; ")
                            found[kinds[kind]].add((reason, remedy))
    return found


def _texts(
    node: ast.AST, names: dict[str, ast.expr], reports: bool, stops: bool
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
        args = [_template(each, dict(names)) for each in node.args]
        if kind == "LinkError":
            yield ast.unparse(node.args[0]), "; ".join(args[1:])
        elif kind.endswith(("Error", "wrong", "Refusal")):
            yield kind, f"{args[2]}; {args[3]}" if len(args) == 4 else args[0] if len(args) == 1 else ""
        elif args:
            yield "Stalled" if stops and kind == "append" else kind, max(args, key=len)
    elif reports and isinstance(node, ast.Return) and isinstance(node.value, ast.Constant | ast.JoinedStr):
        yield "Stalled", _template(node.value, {})
    elif stops and isinstance(node, ast.Tuple | ast.List | ast.Return):
        parts = [node.value] if isinstance(node, ast.Return) else node.elts
        yield from (("Stalled", _template(part, {})) for part in parts if isinstance(part, ast.JoinedStr))


def tables() -> str:
    """The page's tables, in Markdown."""
    lines = []
    for symptom, entries in messages().items():
        lines += [f"\n### {symptom}\n", "| message | what to do |", "| --- | --- |"]
        lines += [f"| {reason} | {remedy} |".replace("<", "&lt;") for reason, remedy in sorted(entries)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(PAGE.read_text().partition(MARK)[0] + MARK + tables())
