"""The arm of Franka Robotics: any arm, over a link to its control interface."""

from drivers.arm.driver import ArmDriver
from drivers.franka_arm.link import FrankaLink
from drivers.franka_arm.settings import FrankaArmSettings


class FrankaArm(ArmDriver):
    """A Franka arm on an approach axis; see `ArmDriver`.

    Should the arm's process die or miss its cycles, the robot stops by itself: libfranka's control is cyclic. A
    reflex, a user stop and guiding are `Stalled`: `Home` recovers from a reflex. `<name>.force` is
    `O_F_ext_hat_K`: estimated from the joints' torques, no sensor's.
    """

    link = FrankaLink
    _settings: FrankaArmSettings

    def zero_setting(self, stream: str) -> str:
        """See `OwnZero.zero_setting`: what is subtracted from the robot's estimate is forgotten."""
        return ""
