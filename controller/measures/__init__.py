"""From a trial's recording to its row in trials.csv: one module per experiment."""
