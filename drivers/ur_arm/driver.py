"""The arm of Universal Robots: any arm, over a link to its controller."""

from drivers.arm.driver import ArmDriver
from drivers.ur_arm.aside import stop_beside
from drivers.ur_arm.link import UrLink
from drivers.ur_arm.settings import UrArmSettings


class UrArm(ArmDriver):
    """A UR arm on an approach axis; see `ArmDriver`.

    Should the arm's process die, the controller's watchdog stops the arm. A protective stop, a program that was
    stopped and a watchdog that tripped are `Stalled`: `Home` unlocks the arm and starts the program again.
    `<name>.force` is `actual_TCP_force`.
    """

    link = UrLink
    stop_beside = staticmethod(stop_beside)
    _settings: UrArmSettings
