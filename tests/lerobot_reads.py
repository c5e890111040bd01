"""Runs of ours, loaded by LeRobot itself from an environment of its own: python -m tests.lerobot_reads PYTHON

In this program's environment it makes and exports the runs; LeRobot's runs the same file, with what was exported.
"""

import subprocess
import sys
import tempfile

RUNS = (
    ("mock/transient", "--only", "1", "--only", "16", "--set", "behavior.settle_s=2.0"),
    ("mock/centering", "--only", "1"),
)
"""Streams of one channel and of several, in two episodes and in one."""


def main(python: str) -> None:
    """Make the runs, export them, and have LeRobot load them."""
    from config.verbs.results import export
    from config.verbs.running import run

    for arguments in RUNS:
        with tempfile.TemporaryDirectory() as out:
            run.main([*arguments, "--no-report", "--out", out], standalone_mode=False)
            for to in ("lerobot", "parquet"):
                asked = ["latest", "--to", to, "--into", f"{out}/{to}", "--out", out]
                export.main(asked, standalone_mode=False)
            loading = [python, __file__, f"{out}/lerobot", f"{out}/parquet/samples.parquet"]
            subprocess.run(loading, check=True, env={"HF_HUB_OFFLINE": "1", "HF_HOME": f"{out}/cache"})


def load(root: str, samples: str) -> None:
    """Load a dataset as a training program does, and compare the result with the run's samples.

    Args:
        root: Folder of the dataset.
        samples: The same run as a tidy table, trials in the order of the episodes.
    """
    import lerobot  # type: ignore[import-not-found]
    import numpy as np
    import pandas as pd
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # type: ignore[import-not-found]
    from torch.utils.data import DataLoader  # type: ignore[import-not-found]

    dataset = LeRobotDataset("local/touchbench", root=root)
    frames = dataset.hf_dataset.to_pandas()
    table = pd.read_parquet(samples)
    trials = table["trial"].unique()
    assert dataset.num_episodes == len(trials)
    compared = 0
    for (trial, stream), whole in table.groupby(["trial", "stream"], sort=False):
        episode = frames[frames["episode_index"] == list(trials).index(trial)]
        present = episode.dropna(subset=f"time.{stream}").drop_duplicates(f"time.{stream}")
        values = np.array(present[f"observation.{stream}"].to_list()).reshape(len(present), -1)
        for channel, own in whole.groupby("channel"):
            np.testing.assert_array_equal(present[f"time.{stream}"], own["t_s"])
            np.testing.assert_allclose(values[:, channel], own["value"], rtol=1e-6, atol=1e-12)
            compared += len(own)
    assert compared == len(table)
    stream = next(name for name in dataset.features if name.startswith("observation."))
    step_s = 1.0 / dataset.fps
    last = LeRobotDataset(
        "local/touchbench", root=root, episodes=[len(trials) - 1], delta_timestamps={stream: [-step_s, 0.0]}
    )
    np.testing.assert_array_equal(last[1][stream][0], last[0][stream][1])
    batch = next(iter(DataLoader(dataset, batch_size=64, shuffle=True)))
    assert set(batch) == {*dataset.features, "task"}
    print(  # noqa: T201 - what was asked for
        f"LeRobot {lerobot.__version__}: {len(trials)} episodes, {len(dataset)} frames, {compared} samples equal"
    )


if __name__ == "__main__":
    load(*sys.argv[1:]) if len(sys.argv) > 2 else main(sys.argv[1])
