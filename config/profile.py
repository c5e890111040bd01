"""A profile: TOML in, frozen and validated settings out, each mistake named with file, section and key."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from config.sections import Entry, Sections
from config.source import (
    ABSENT,
    TAKEN_OFF,
    UNSET,
    Bench,
    KeyPath,
    ProfileError,
    Source,
    Table,
    nest,
    read_source,
    with_value,
    without_absent,
)
from config.trials import Trial, TrialsSettings
from config.validation import as_table, validated
from controller.own_modules import found
from controller.registry import PARTS, find, settings_of
from drivers.core.settings import Settings

TRIAL_SECTIONS = ("signals", "detectors", "behavior", "limits", "plant")
"""What a trial's dotted factors may change: devices and loop are set up once for all trials."""


@dataclass(frozen=True)
class Profile:
    """A bench and what to do on it.

    Attributes:
        name: `mock/transient`, or a path.
        bench: What the devices' ports make of it.
        devices: By name, in the order of the profile.
        plant: The physics, None on hardware.
        faults: What goes wrong on purpose, each of the table's class for it.
        unverified: Streams that no device has until it is open: where each is named, and its name.
        deferred: What must not be used as it is, a line each, by the path of the setting: `config.needs`.
        excused: Of these settings, which need no value where nothing is run.
    """

    name: str
    title: str
    description: str
    experiment: str
    bench: Bench
    devices: Mapping[str, Entry]
    signals: Mapping[str, Entry]
    detectors: Mapping[str, Entry]
    behavior: Settings
    limits: Settings
    loop: Settings
    plant: Entry | None
    faults: tuple[Any, ...]
    trial_settings: TrialsSettings
    unverified: Sequence[tuple[str, str]] = field(repr=False, compare=False)
    deferred: Mapping[KeyPath, str] = field(repr=False, compare=False)
    source: Source = field(repr=False, compare=False)
    excused: frozenset[KeyPath] = field(default=frozenset(), repr=False, compare=False)

    @property
    def real_ports(self) -> Mapping[str, str]:
        """On an emulated bench: devices at a port of their own, and which. Beside them its time may not pause."""
        emulated = self.bench == "emulated"
        return {
            name: entry.port for name, entry in self.devices.items() if emulated and entry.port != "emulated"
        }

    @cached_property
    def resolved(self) -> Table:
        """Every setting with its value, defaults included, as JSON and TOML can hold it; loads again."""
        plant = {"plant": _chosen(self.plant)} if self.plant else {}
        off = {name: dict.fromkeys(sorted(gone), ABSENT) for name, gone in self.source.absent.items()}
        return {
            "title": self.title,
            "description": self.description,
            "experiment": self.experiment,
            **{
                section: {name: _chosen(entry) for name, entry in getattr(self, section).items()}
                | off.get(section, {})
                for section in TAKEN_OFF
            },
            "behavior": as_table(self.behavior),
            "limits": as_table(self.limits),
            "loop": as_table(self.loop),
            **plant,
            "faults": [as_table(fault) for fault in self.faults],
            "trials": as_table(self.trial_settings),
        }

    @property
    def shown(self) -> Table:
        """Likewise, for people: where a value is not set stands how to find it."""
        table = self.resolved
        for path, hint in self.source.unset.items():
            table = with_value(table, path, f"{UNSET} {hint}")
        return table

    @cached_property
    def hash(self) -> str:
        """SHA-256 of the resolved profile, hexadecimal: equal settings, equal hash, whatever the files."""
        canonical = json.dumps(self.resolved, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
        return hashlib.sha256(canonical.encode()).hexdigest()

    def trials(self, seed: int) -> list[Trial]:
        """The trials in the order in which they are run."""
        return [*self.trial_settings.trials(seed)]

    def for_trial(self, trial: Trial) -> Profile:
        """This profile with a trial's dotted factors laid over it.

        Raises:
            ProfileError: a factor that the profile does not know, or out of its range.
        """
        if not trial.overrides:
            return self
        for name in trial.overrides:
            if name.partition(".")[0] not in TRIAL_SECTIONS or name == "plant.kind":
                raise ProfileError(
                    f"{self._where(trial, name)}: not for a trial to change, as devices and plant are set up once for"
                    f" the run; a trial may change {', '.join(TRIAL_SECTIONS)}"
                )
        key = repr(sorted(trial.overrides.items()))
        if key not in self._varied:
            alone = replace(self.source, data={**self.source.data, "trials": {}})
            own = _read(alone.joined(nest(trial.overrides.items()), self._where(trial)))
            own = replace(own, trial_settings=self.trial_settings, source=self.source, excused=self.excused)
            same = {
                each.name: _same(getattr(self, each.name), getattr(own, each.name)) for each in fields(self)
            }
            self._varied[key] = replace(own, **same)
        return self._varied[key]

    @cached_property
    def _varied(self) -> dict[str, Profile]:
        """What trials made of this profile, by what they change: each is asked for several times."""
        return {}

    def factors_of(self, trial: Trial) -> Settings:
        """A trial's own factors, validated.

        Raises:
            ProfileError: a factor that the experiment does not know, lacks, or out of its range.
        """
        model = settings_of(find("experiment", self.experiment, self.source.folders).made, "factors")
        return validated(model, trial.own, lambda place: self._where(trial, ".".join(place)))

    def _where(self, trial: Trial, factor: str = "") -> str:
        """Where a trial's factor was written."""
        settings, origins = self.trial_settings, self.source.origins
        cells = math.prod(len(values) for values in settings.grid.values())
        row = (trial.id - 1) // settings.repeats // cells
        outside = origins.get(("trials", "list", str(row)))
        if outside:
            return f"{outside}, column {factor}" if factor else outside
        if factor in settings.grid:
            return f"{self.source.origin(('trials', 'grid'))}: [trials.grid] {factor}"
        place = f"{self.source.origin(('trials', 'list'))}: [trials] list row {row + 1}"
        return f"{place}: {factor}" if factor else place


def _same(ours: Any, other: Any) -> Any:
    """The other, made of ours where they are equal: what ten thousand trials have in common is there once."""
    if ours == other:
        return ours
    if isinstance(ours, dict) and isinstance(other, dict):
        return {name: _same(ours.get(name), each) for name, each in other.items()}
    return other


def _chosen(entry: Entry) -> Table:
    """A kind and its settings; of a device its driver, and its port in place of its address."""
    own = as_table(entry.settings)
    if not entry.port:
        return {"kind": entry.kind, **own}
    without = {key: value for key, value in own.items() if key not in entry.settings.keys_of("address")}
    return {"driver": entry.kind, "port": entry.port, **without}


def load_profile(
    name_or_path: str | Path,
    overrides: Mapping[str, str] | None = None,
    *,
    rows: Mapping[str, Mapping[str, Any]] | None = None,
) -> Profile:
    """Load a profile with all that it extends, and validate all of it, the trials included.

    Args:
        name_or_path: A name under config/profiles (`mock/transient`), or the path of a TOML file.
        overrides: `{"limits.force_n": "1.5"}`: TOML values, or plain text; applied last.
        rows: Trials from elsewhere, in place of the profile's list and grid: nested or dotted factors by where they
            stand, for errors.

    Raises:
        ProfileError: one line for each thing that is wrong; the first one decides.
    """
    source = read_source(name_or_path, overrides)
    if rows is not None:
        source = source.with_rows(rows)
    return _checked(_read(source))


def load_resolved(name: str, resolved: Mapping[str, Any], folders: Sequence[Path] = ()) -> Profile:
    """Load what `Profile.resolved` gave, for example from a manifest.

    Args:
        folders: Where modules of the user's own are looked for.

    Raises:
        ProfileError: it was written by a program that knew other settings.
    """
    source = Source(name, (name,), {}, {}, tuple(folders)).joined(resolved, name)
    return _checked(_read(without_absent(source)))


def _read(source: Source) -> Profile:
    sections = Sections(source)
    tables, bench, devices = sections.tables, sections.bench(), sections.devices()
    profile = Profile(
        name=source.name,
        title=tables.title,
        description=tables.description,
        experiment=tables.experiment,
        bench=bench,
        devices=devices,
        signals=sections.signals(),
        detectors=sections.entries("detector"),
        behavior=sections.behavior(),
        limits=sections.settings(found(PARTS["limits"]), tables.limits, ("limits",)),
        loop=sections.settings(found(PARTS["loop"]), tables.loop, ("loop",)),
        plant=sections.plant(bench),
        faults=sections.faults(bench, devices),
        trial_settings=tables.trials,
        unverified=tuple(sections.unverified),
        deferred=sections.deferred,
        source=source,
    )
    sections.check_together()
    if sections.problems:
        raise ProfileError(list(dict.fromkeys(sections.problems)))
    return profile


def _checked(profile: Profile) -> Profile:
    """The same profile, if all its trials can be run with it."""
    trials = profile.trial_settings
    for trial in trials.trials()[:: trials.repeats]:
        profile.factors_of(trial)
        profile.for_trial(trial)
    return profile
