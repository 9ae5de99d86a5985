"""The conditions in which a driver's sensors and the car's steering err.

`frenetic.drivers.sensor_errors` and `frenetic.drivers.steering_errors` have their wrappers. The
ranges are our choice.
"""

from __future__ import annotations

import math
from typing import Final

from frenetic.conditions.declaration import Condition

_SENSORS: Final = "frenetic.drivers.sensor_errors"
_STEERING: Final = "frenetic.drivers.steering_errors"

STEERING_RESOLUTION: Final = Condition(
    name="steering_resolution",
    about="step of the steering angle, to whose multiples each command is rounded",
    unit="rad",
    low=0.0,
    high=0.5,
    usual=(0.0, 0.02),
    no_effect=0.0,
    wrapper=f"{_STEERING}:SteeringResolution",
    words=("a finer steering resolution", "a coarser steering resolution"),
)
STEERING_GAIN: Final = Condition(
    name="steering_gain",
    about="angle that the steering makes of a commanded angle, as a factor",
    low=0.0,
    high=3.0,
    usual=(0.8, 1.2),
    no_effect=1.0,
    wrapper=f"{_STEERING}:SteeringGain",
    words=("a lower steering gain", "a higher steering gain"),
)
STEERING_OFFSET: Final = Condition(
    name="steering_offset",
    about="angle by which the wheels stand to the left of the commanded angle",
    unit="rad",
    low=-0.5,
    high=0.5,
    usual=(-0.02, 0.02),
    no_effect=0.0,
    wrapper=f"{_STEERING}:SteeringOffset",
    words=("more steering offset to the right", "more steering offset to the left"),
)
STEERING_DEAD_BAND: Final = Condition(
    name="steering_dead_band",
    about="difference from the commanded angle up to which the steering does not move",
    unit="rad",
    low=0.0,
    high=0.5,
    usual=(0.0, 0.02),
    no_effect=0.0,
    wrapper=f"{_STEERING}:SteeringDeadBand",
    words=("a smaller steering dead band", "a larger steering dead band"),
)
STEERING_RATE: Final = Condition(
    name="steering_rate",
    about="fastest change of the steering angle, beside the car's limit",
    unit="rad/s",
    low=0.01,
    high=100.0,
    usual=(0.1, 0.4),
    no_effect=math.inf,
    wrapper=f"{_STEERING}:SteeringRate",
    words=("slower steering", "faster steering"),
)
LATERAL_BIAS: Final = Condition(
    name="lateral_bias",
    about="constant error of the driver's lateral place, to the left",
    unit="m",
    low=-10.0,
    high=10.0,
    usual=(-0.2, 0.2),
    no_effect=0.0,
    wrapper=f"{_SENSORS}:LateralBias",
    words=("more lateral bias to the right", "more lateral bias to the left"),
)
HEADING_BIAS: Final = Condition(
    name="heading_bias",
    about="constant error of the driver's heading, to the left",
    unit="rad",
    low=-0.5,
    high=0.5,
    usual=(-0.02, 0.02),
    no_effect=0.0,
    wrapper=f"{_SENSORS}:HeadingBias",
    words=("more heading bias to the right", "more heading bias to the left"),
)
YAW_RATE_BIAS: Final = Condition(
    name="yaw_rate_bias",
    about="constant error of the yaw rate that the driver reads, to the left",
    unit="rad/s",
    low=-2.0,
    high=2.0,
    usual=(-0.05, 0.05),
    no_effect=0.0,
    wrapper=f"{_SENSORS}:YawRateBias",
    words=("more yaw rate bias to the right", "more yaw rate bias to the left"),
)
SPEED_BIAS: Final = Condition(
    name="speed_bias",
    about="constant error of the speed that the driver reads",
    unit="km/h",
    low=-100.0,
    high=100.0,
    usual=(-5.0, 5.0),
    no_effect=0.0,
    wrapper=f"{_SENSORS}:SpeedBias",
    words=("a lower speed reading", "a higher speed reading"),
)
LATERAL_DROPOUT: Final = Condition(
    name="lateral_dropout",
    about="share of the time in which the lateral place stays at its last reading",
    low=0.0,
    high=1.0,
    usual=(0.0, 0.5),
    no_effect=0.0,
    wrapper=f"{_SENSORS}:LateralDropout",
    is_seeded=True,
    words=("less lateral dropout", "more lateral dropout"),
)
HEADING_DROPOUT: Final = Condition(
    name="heading_dropout",
    about="share of the time in which the heading stays at its last reading",
    low=0.0,
    high=1.0,
    usual=(0.0, 0.5),
    no_effect=0.0,
    wrapper=f"{_SENSORS}:HeadingDropout",
    is_seeded=True,
    words=("less heading dropout", "more heading dropout"),
)
YAW_RATE_DROPOUT: Final = Condition(
    name="yaw_rate_dropout",
    about="share of the time in which the yaw rate stays at its last reading",
    low=0.0,
    high=1.0,
    usual=(0.0, 0.5),
    no_effect=0.0,
    wrapper=f"{_SENSORS}:YawRateDropout",
    is_seeded=True,
    words=("less yaw rate dropout", "more yaw rate dropout"),
)
SPEED_DROPOUT: Final = Condition(
    name="speed_dropout",
    about="share of the time in which the speed stays at its last reading",
    low=0.0,
    high=1.0,
    usual=(0.0, 0.5),
    no_effect=0.0,
    wrapper=f"{_SENSORS}:SpeedDropout",
    is_seeded=True,
    words=("less speed dropout", "more speed dropout"),
)

STEERING_CONDITIONS: Final = (
    STEERING_RESOLUTION,
    STEERING_GAIN,
    STEERING_OFFSET,
    STEERING_DEAD_BAND,
    STEERING_RATE,
)
"""Errors of the steering, in the order in which a command passes them."""
SENSOR_CONDITIONS: Final = (
    LATERAL_BIAS,
    HEADING_BIAS,
    YAW_RATE_BIAS,
    SPEED_BIAS,
    LATERAL_DROPOUT,
    HEADING_DROPOUT,
    YAW_RATE_DROPOUT,
    SPEED_DROPOUT,
)
"""Errors of sensors, in the order in which a reading passes them."""
