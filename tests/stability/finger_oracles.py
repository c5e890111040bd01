"""A way of moving the finger that shares no code and no logic with the plant.

`modal` solves each piece by eigenvectors in many digits and finds each switch by scanning and bisection. It is written
from the equations of docs/explanation/finger_physics.md.
"""

from collections.abc import Callable, Sequence

from mpmath import mp, mpf

from simulator.physics.finger_settings import LOCATIONS, FingerSettings

_REAL = 1e-20
"""An eigenvalue whose imaginary part is smaller is real, 1/s: what is left of it is the digits' own rounding."""

_GONE = 1e-32
"""A mode that has died down to it, in units of the state, turns no guard: times 1e9 N/m it is 1e-23 N."""

Switch = tuple[float, str]
TH, OM, B, BE, A, G1, G2, V = range(8)


def arm_and_stiffness(s: FingerSettings, location: str) -> tuple[float, float]:
    """l and k2 of a location."""
    side, from_tip_m = LOCATIONS[location]
    return s.arm_f_m + LOCATIONS["f"][1] - from_tip_m, s.pad_n_m if side == "pad" else s.back_n_m


class _Modes:
    """x' = M x + p0 + p1 t + p2 t^2 in eigenvectors."""

    def __init__(self, matrix: list[list[mpf]]) -> None:
        m = mp.matrix(matrix)
        self.values, right = mp.eig(m)
        self.right = right
        self.left = right**-1
        self.inverse = m**-1
        self.stiffest = float(max(abs(value) for value in self.values))

    def start(
        self, x: Sequence[mpf], p0: list[mpf], p1: list[mpf], p2: list[mpf]
    ) -> tuple[Callable[[mpf], list[mpf]], Callable[[mpf], mpf]]:
        """The solution from `x` at time 0 on, and how far apart it is to be looked at, by time."""
        q2 = -(self.inverse * mp.matrix(p2))
        q1 = self.inverse * (2 * q2 - mp.matrix(p1))
        q0 = self.inverse * (q1 - mp.matrix(p0))
        amplitudes = self.left * (mp.matrix(x) - q0)
        # a state is a sum of products of real numbers: parts of exp(value t) and powers of t, each with its weight; of
        # two conjugate values one stands for both
        kept = [j for j, value in enumerate(self.values) if mp.im(value) > -_REAL]
        weights = []
        for i in range(len(x)):
            twice = [2 if mp.im(self.values[j]) > _REAL else 1 for j in kept]
            shares = [self.right[i, j] * amplitudes[j] * n for j, n in zip(kept, twice, strict=True)]
            parts = [*map(mp.re, shares), *(-mp.im(share) for share in shares)]
            weights.append([*parts, q0[i], q1[i], q2[i]])

        values = [self.values[j] for j in kept]

        def at(t: mpf) -> list[mpf]:
            powers = [mp.exp(value * t) for value in values]
            basis = [*map(mp.re, powers), *map(mp.im, powers), mpf(1), t, t * t]
            return [mp.fdot(weight, basis) for weight in weights]

        lasting = []
        for j in kept:
            size = max(abs(self.right[i, j]) for i in range(len(x))) * abs(amplitudes[j])
            decay = -mp.re(self.values[j])
            until = mp.log(size / _GONE) / decay if decay and size else mp.inf
            lasting.append((until, mp.im(self.values[j])))

        def apart(t: mpf) -> mpf:
            alive = [turn for until, turn in lasting if t < until]
            fastest = max([mpf(150), *alive])
            # where what is fast has died, the force on what is stiff follows the rest
            return mpf("0.15") / (fastest if len(alive) == len(lasting) else max(fastest, mpf(1500)))

        return at, apart


def modal(
    s: FingerSettings,
    *,
    pieces: Sequence[tuple[float, float, float, float]],
    gap_m: float,
    until_s: float,
    samples_s: Sequence[float],
    location: str = "f",
    digits: int = 40,
    start_s: float = 0.0,
    excited: bool = True,
) -> tuple[list[Switch], list[float]]:
    """Switches and theta at some times, from rest at `start_s`, without noise.

    Args:
        s: The finger.
        pieces: The probe's plan.
        gap_m: Where it would touch the finger at rest.
        until_s: The end.
        samples_s: Ascending times at which theta is wanted.
        location: Of the contact.
        digits: Decimal digits to work with.
        start_s: The beginning.
        excited: Whether the drive is on.
    """
    with mp.workdps(digits):
        reference = _Reference(s, pieces, gap_m, location, start_s, excited)
        wanted, thetas, switches = [mpf(t) for t in samples_s], [], []
        while reference.now < until_s:
            at, apart, guards, limit = reference.piece(mpf(until_s))
            stiffest = reference.modes[reference.mode == "touching"].stiffest
            elapsed, name = _first(at, apart, guards, limit, stiffest)
            inside = [t for t in wanted if t <= reference.now + elapsed]
            thetas += [float(at(t - reference.now)[TH]) for t in inside]
            wanted = wanted[len(inside) :]
            reference.go(at, elapsed)
            switch = reference.switched(name)
            if switch:
                switches.append((float(reference.now), switch))
        return switches, thetas


class _Reference:
    """The finger in many digits: where it stands, and what the piece under way is."""

    def __init__(self, s, pieces, gap_m, location, start_s, excited):  # type: ignore[no-untyped-def]
        self.s, self.excited, self.gap = s, excited, mpf(gap_m)
        self.arm, self.k2 = (mpf(number) for number in arm_and_stiffness(s, location))
        self.c2 = mpf(s.contact_n_s_m)
        self.fr = 2 * mp.pi * mpf(s.loop_hz)
        self.pieces = [tuple(mpf(number) for number in piece) for piece in pieces]
        self.modes = {touching: _Modes(self._matrix(touching)) for touching in (False, True)}
        self.x = [mpf(0)] * 7 + [mpf(1) / 2]
        self.phase, self.now = mpf(0), mpf(start_s)
        self.mode, self.comparator, self.drive = "free", 0, 0

    def _matrix(self, touching: bool) -> list[list[mpf]]:
        s = self.s
        inertia, base_inertia = mpf(s.inertia_kg_m2), mpf(s.base_inertia_kg_m2)
        fa, fh = 2 * mp.pi * mpf(s.accelerometer_hz), 2 * mp.pi * mpf(s.high_pass_hz)
        m = [[mpf(0)] * 8 for _ in range(8)]
        m[TH][OM] = m[B][BE] = mpf(1)
        for state, other, size in ((TH, B, mpf(s.joint_n_m_rad)), (OM, BE, mpf(s.joint_n_m_s_rad))):
            m[OM][state] -= size / inertia
            m[OM][other] += size / inertia
            m[BE][state] += size / base_inertia
            m[BE][other] -= size / base_inertia
        m[BE][B] -= mpf(s.base_n_m_rad) / base_inertia
        m[BE][BE] -= mpf(s.base_n_m_s_rad) / base_inertia
        if touching:
            m[OM][TH] -= self.k2 * self.arm**2 / inertia
            m[OM][OM] -= self.c2 * self.arm**2 / inertia
        for j in range(4):
            m[A][j] = -fa * mpf(s.accelerometer_arm_m) * m[BE][j]
        m[A][A] = -fa
        m[G1][A], m[G1][G1], m[G1][G2] = fh, -fh / mpf(s.high_pass_quality), -fh
        m[G2][G1] = fh
        m[V][V] = -self.fr
        return m

    def piece(self, end: mpf):  # type: ignore[no-untyped-def]
        """The solution from now on, what can end it, and how long it lasts at most."""
        s, mode = self.s, self.mode
        present = max(i for i, piece in enumerate(self.pieces) if piece[0] <= self.now)
        corner, p, v, a = self.pieces[present]
        since = self.now - corner
        position, velocity = p + v * since + a * since**2 / 2, v + a * since
        inertia, detected = mpf(s.inertia_kg_m2), mpf(self.comparator ^ self.drive)
        p0, p1, p2 = ([mpf(0)] * 8 for _ in range(3))
        if self.excited:
            p0[OM] = (mpf(s.drive_n_m) if self.drive else -mpf(s.drive_n_m)) / inertia
        if mode == "touching":
            p0[OM] += self.arm * (self.k2 * (position - self.gap) + self.c2 * velocity) / inertia
            p1[OM] = self.arm * (self.k2 * velocity + self.c2 * a) / inertia
            p2[OM] = self.arm * self.k2 * a / 2 / inertia
        p0[V] = self.fr * detected
        phase, control, comparator = self.phase, self.x[V] - detected, self.comparator
        f0, f1 = mpf(s.oscillator_lowest_hz), mpf(s.oscillator_range_hz)

        def depth(t, y):  # type: ignore[no-untyped-def]
            return position + velocity * t + a * t * t / 2 - self.gap - self.arm * y[TH]

        def push(t, y):  # type: ignore[no-untyped-def]
            return self.k2 * depth(t, y) + self.c2 * (velocity + a * t - self.arm * y[OM])

        def turned(t, y):  # type: ignore[no-untyped-def]
            charged = control * (1 - mp.exp(-self.fr * t)) / self.fr
            return phase + (f0 + f1 * detected) * t + f1 * charged - mpf(1) / 2

        def compared(t, y):  # type: ignore[no-untyped-def]
            output = y[A] - y[G1] / mpf(s.high_pass_quality) - y[G2]
            return (-output if comparator else output) - mpf(s.hysteresis_m_s2)

        guards = {"compared": compared, "turned": turned}
        if mode == "free":
            guards["made"] = depth
        elif mode == "touching":
            guards["lost"] = lambda t, y: -push(t, y)
        else:
            guards["apart"] = lambda t, y: -depth(t, y)
            guards["made"] = push
        self._turned = turned
        limit = min([end, *(piece[0] for piece in self.pieces if piece[0] > self.now)]) - self.now
        return *self.modes[mode == "touching"].start(self.x, p0, p1, p2), guards, limit

    def go(self, at, elapsed: mpf) -> None:  # type: ignore[no-untyped-def]
        """On to the end of the piece."""
        self.x = at(elapsed)
        self.phase = self._turned(elapsed, self.x) + mpf(1) / 2
        self.now += elapsed

    def switched(self, name: str) -> str:
        """Do what the end of a piece asks for; its name as a switch, or nothing."""
        if name == "compared":
            self.comparator ^= 1
            return "comparator_up" if self.comparator else "comparator_down"
        if name == "turned":
            self.drive ^= 1
            self.phase = mpf(0)
            return "drive_up" if self.drive else "drive_down"
        if name == "made":
            self.mode = "touching"
        elif name == "lost":
            self.mode = "clipped" if self.c2 > 0 else "free"
        elif name == "apart":
            self.mode = "free"
        elif name == "nothing":
            name = self._corner()
        return name if name in ("made", "lost") else ""

    def _corner(self) -> str:
        """The probe's velocity may have jumped, and with it P: what that switches, or nothing."""
        corner, p, v, a = max(piece for piece in self.pieces if piece[0] <= self.now)
        since = self.now - corner
        depth = p + v * since + a * since**2 / 2 - self.gap - self.arm * self.x[TH]
        push = self.k2 * depth + self.c2 * (v + a * since - self.arm * self.x[OM])
        if self.mode == "touching" and push <= 0:
            self.mode = "clipped" if depth > 0 else "free"
            return "lost"
        if self.mode == "clipped" and push > 0:
            self.mode = "touching"
            return "made"
        return ""


def _first(at, apart, guards, limit, stiffest):  # type: ignore[no-untyped-def]
    """Scan for the first guard that rises through zero: steps that grow from the fastest time scale, then bisection."""
    tiny = mpf(10) ** -20
    # flights after a bounce can be very short, and begin at the level itself
    step = min(mpf("0.05") / stiffest, mpf("1e-8"))
    t = mpf(0)
    before = {name: guard(t, at(t)) for name, guard in guards.items()}
    while t < limit:
        t_next = min(t + step, limit)
        step = min(step * 2, apart(t))
        y = at(t_next)
        after = {name: guard(t_next, y) for name, guard in guards.items()}
        found = [
            (_bisect(at, guards[name], t, t_next), name)
            for name in guards
            if after[name] > 0 and (before[name] < -tiny or (t > 0 and before[name] <= 0))
        ]
        if found:
            return min(found)
        t, before = t_next, after
    return limit, "nothing"


def _bisect(at, guard, low, high):  # type: ignore[no-untyped-def]
    g_low, g_high = guard(low, at(low)), guard(high, at(high))
    for _ in range(200):
        # Illinois: false position that cannot hang on one end
        middle = high - g_high * (high - low) / (g_high - g_low)
        g = guard(middle, at(middle))
        if g > 0:
            if g_high > 0:
                g_low = g_low / 2
            high, g_high = middle, g
        else:
            low, g_low = middle, g
            g_high = g_high / 2 if g_high > 0 else g_high
        if high - low < mpf(10) ** -24 or abs(g) < mpf(10) ** -28:
            return middle
    return high
