"""Layouts with which Foxglove and PlotJuggler open a recording: detectors, guard, signals, states, events."""

import json
from collections.abc import Mapping, Sequence
from itertools import cycle, pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from google.protobuf.descriptor_pb2 import FileDescriptorSet

from controller.recording.mcap_file import topics

PLOTS = 8
"""Most plots of a layout (assumption: what a screen holds one above the other)."""

FOXGLOVE, PLOTJUGGLER = "foxglove.json", "plotjuggler.xml"

COLOURS = ("#0072b2", "#d55e00", "#5b5b5b", "#cc79a7")
"""Of a plot's curves, as in the reports: statistic, threshold, the others."""

_FIRST = ("/detector/", "/guard/")
_OTHERS = ("/raw/", "/skipped", "/events", "/state")


def write_layouts(recording: Path) -> None:
    """Write both beside a recording.

    Raises:
        OSError: it cannot be read, or nothing be written.
        ValueError: it was cut off.
    """
    plots = plotted(recording)
    recording.with_name(FOXGLOVE).write_text(json.dumps(foxglove(plots), indent=1) + "\n", "utf-8")
    recording.with_name(PLOTJUGGLER).write_text(plotjuggler(plots), "utf-8")


def plotted(recording: Path) -> Mapping[str, Sequence[str]]:
    """Topics to plot with their fields, the most informative first."""
    found = {}
    for channel, schema in topics(recording).values():
        if not channel.topic.startswith(_OTHERS):
            described = FileDescriptorSet.FromString(schema.data)
            names = [field.name for field in described.file[-1].message_type[0].field]
            found[channel.topic] = [name for name in names if name != "t_s"]
    order = sorted(found, key=lambda topic: (not topic.startswith(_FIRST), topic))
    return {topic: found[topic] for topic in order[:PLOTS]}


def foxglove(topics: Mapping[str, Sequence[str]]) -> dict[str, Any]:
    """A layout of Foxglove: plots one above the other, the states below, events beside them."""
    panels: dict[str, Any] = {
        f"Plot!{topic[1:].replace('/', '_')}": {
            "foxglovePanelTitle": topic,
            "paths": [
                {
                    "value": f"{topic}.{field}",
                    "enabled": True,
                    "timestampMethod": "receiveTime",
                    "color": colour,
                }
                for field, colour in zip(fields, cycle(COLOURS), strict=False)
            ],
            "showLegend": True,
            "isSynced": True,
        }
        for topic, fields in topics.items()
    }
    panels["StateTransitions!state"] = {
        "paths": [{"value": "/state.state", "timestampMethod": "receiveTime"}],
        "isSynced": True,
    }
    above: Any = None
    for name in reversed(panels):
        left = list(panels)[list(panels).index(name) :]
        above = (
            name
            if above is None
            else {"first": name, "second": above, "direction": "column", "splitPercentage": 100 / len(left)}
        )
    panels["RosOut!events"] = {"topicToRender": "/events", "minLogLevel": 1, "searchTerms": []}
    layout = {"first": above, "second": "RosOut!events", "direction": "row", "splitPercentage": 70}
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": layout,
    }


def plotjuggler(topics: Mapping[str, Sequence[str]]) -> str:
    """A layout of PlotJuggler: plots one above the other."""
    root = ElementTree.Element("root")
    window = ElementTree.SubElement(root, "tabbed_widget", {"name": "Main Window", "parent": "main_window"})
    tab = ElementTree.SubElement(window, "Tab", tab_name="run", containers="1")
    edges = [round(1e6 * place / max(1, len(topics))) / 1e6 for place in range(len(topics) + 1)]
    sizes = ";".join(f"{after - before:.6f}" for before, after in pairwise(edges))
    container = ElementTree.SubElement(tab, "Container")
    look = {"orientation": "-", "count": str(len(topics)), "sizes": sizes}
    split = ElementTree.SubElement(container, "DockSplitter", look)
    for topic, fields in topics.items():
        area = ElementTree.SubElement(split, "DockArea", name=topic)
        plot = ElementTree.SubElement(area, "plot", mode="TimeSeries", style="Lines")
        for field, colour in zip(fields, cycle(COLOURS), strict=False):
            ElementTree.SubElement(plot, "curve", name=f"{topic}/{field}", color=colour)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"
