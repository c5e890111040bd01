"""The five sensors of Fernandez et al. as settings of the plant: what the paper prints, what was fitted, what is
assumed."""

from __future__ import annotations

from collections.abc import Mapping

from drivers.mock.physics.slip import BridgeSettings, SlipPlantSettings

_CONVERTER_V = 20.0 / 2**16
"""One step of the paper's NI PCIe-6363 (4.1): 16 bits over +-10 V, the range being an assumption."""

FINGERTIP = SlipPlantSettings(
    mode_hz=180.0,
    rolling_n=0.087,
    bridges=(
        BridgeSettings(
            name="Fx",
            normal_sine=1.0,
            gain=0.0694,
            full_scale_n=7.0,
            hysteresis=0.06,
            noise=0.0024,
            step=_CONVERTER_V,
        ),
        BridgeSettings(
            name="Fy",
            normal_cosine=1.0,
            gain=0.0326,
            full_scale_n=7.0,
            hysteresis=0.048,
            noise=0.0011,
            step=_CONVERTER_V,
        ),
        BridgeSettings(
            name="Ft",
            tangential=1.0,
            gain=1.0291,
            full_scale_n=1.0,
            hysteresis=0.05,
            noise=0.0029,
            step=_CONVERTER_V,
        ),
    ),
)
"""B1. Printed: gains, ranges, hysteresis (Fig. 6), mode (4.3), noise floor of Ft (Fig. 9a, d: no bin above 3.5e-5).

The noise of Fx and Fy makes the printed resolution 3.5 standard deviations, as it is for Ft.
Fit: rolling so that the lowest bin of Ft is 0.045 (Fig. 9b), roughness so that the peak in slip is 0.12 (Fig. 9c).
"""

FLEXIBLE_FINGER = SlipPlantSettings(
    mode_hz=125.0,
    rolling_n=0.041,
    bridges=(
        BridgeSettings(
            name="bending", tangential=1.0, gain=0.32, full_scale_n=1.0, noise=0.002, step=_CONVERTER_V
        ),
    ),
)
"""B2. Printed: mode (5.1), threshold 0.25. Fit: gain so that the product peaks at 4 (Fig. 13b), rolling so that the
paper's threshold holds for about an hour. Assumption: noise, "medium" in Table 1."""

BARRETT_FINGER = SlipPlantSettings(
    mode_hz=375.0,
    rolling_n=0.041,
    bridges=(
        BridgeSettings(
            name="torque", tangential=1.0, gain=0.24, full_scale_n=1.0, noise=0.005, step=_CONVERTER_V
        ),
    ),
)
"""B3. Printed: mode (5.2). Fit: gain so that the product peaks at 3 (Fig. 15b). Assumption: noise, "high" in Table
1."""

JR3_WRIST = SlipPlantSettings(
    unit="N",
    mode_hz=1300.0,
    mass_kg=0.5,
    normal_n_m=5e4,
    event_load_n=50.0,
    rolling_n=5.0,
    bridges=(
        BridgeSettings(
            name="Fz", tangential=0.1, normal_cosine=1.0, gain=1.0, full_scale_n=200.0, noise=0.15, step=0.05
        ),
    ),
)
"""B4, on Fz. Printed: range, digital resolution 0.05 N (5.3), Fz of -40 to -60 N (Fig. 17a). Fit: rolling so that
its product reaches 300 (Fig. 17b). Assumption: a stiff mode far above half the sample rate, coupling, noise
("high")."""

DSA_TAXEL = SlipPlantSettings(
    unit="mV",
    rate_hz=100.0,
    mode_hz=70.0,
    damping_ratio=0.3,
    rolling_n=0.2,
    rolling_hz=2.0,
    load_low=30.0,
    load_high=100.0,
    load_rise_s=0.02,
    bridges=(
        BridgeSettings(
            name="taxel",
            tangential=0.05,
            normal_cosine=0.5,
            gain=1000.0,
            full_scale_n=8.0,
            noise=5.0,
            step=1.0,
        ),
    ),
)
"""B5, one taxel. Printed: 10 ms between samples (5.4), level of 1,500 to 4,000 mV (Fig. 19a). Assumption: a rubber
that rings at 70 Hz and damps, noise ("low" in Table 1), rolling, coupling."""

SENSORS: Mapping[str, SlipPlantSettings] = {
    "fingertip": FINGERTIP,
    "flexible_finger": FLEXIBLE_FINGER,
    "barrett_finger": BARRETT_FINGER,
    "jr3_wrist": JR3_WRIST,
    "dsa_taxel": DSA_TAXEL,
}
"""B1 to B5 by name."""
