"""What makes an experiment run: loop, guard, detectors, recorder and reports."""
