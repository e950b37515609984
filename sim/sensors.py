"""Encoders, load cells and wrench sensors: data-sheet figures, presets and simulated readings."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import scipy

from tulip_testbed.measurements.cells import CELLS
from tulip_testbed.measurements.contacts import COP, VERTICAL, WRENCH, cops_of_wrenches

Pose = tuple[float, float, float]
Figures = tuple[float, ...]
Three = tuple[float, float, float]  # repeatability, noise and resolution of a sensor
Six = tuple[float, float, float, float, float, float]
Sampling = Callable[..., tuple[np.ndarray, np.ndarray]]

# s, assumed: the shortest motion from one posture to the next, at whose end the error is another one.
CHANGING = 2.0

ANKLE, SOLE, PLATE = PLACES = ("ankle", "sole", "plate")


@dataclass(frozen=True)
class WrenchSensors:
    """Data-sheet figures of a wrench sensor in or under each foot, in place of the plates' cells.

    Figures are in the order of `channels` [N, Nm, of a centre of pressure m]. A sensor has no mass.

    Attributes:
        place: "ankle": in the foot, with the whole foot below it, which it does not weigh; "sole": in the
            foot, below all of its mass; "plate": on the ground, in place of the plate's cells, tared.
        channels: `WRENCH`, `VERTICAL`, or `COP`: the device gives no more than a point and a force.
        repeatability, noise, resolution: as in `Sensors`, by channel.
        zero_sd: s.d. of the true zeros, which are drawn once per experiment and which nobody knows; 0: tared.
        mounting: pose of the sensor's frame, x, y, z, roll, pitch, yaw (fixed axes) [m, rad]: in an ankle in
            the foot's frame, in a sole about the sole point. A plate's frame is at its top.
        below_mass_sd: s.d. of the stated mass of a foot below an ankle, as a share of it.
        below_center_sd: s.d. of every coordinate of its stated centre of mass [m].
    """

    place: str = ANKLE
    channels: tuple[str, ...] = WRENCH
    repeatability: Figures = (0.0,) * 6
    noise: Figures = (0.0,) * 6
    resolution: Figures = (0.0,) * 6
    zero_sd: Figures = (0.0,) * 6
    mounting: Six = (0.0,) * 6
    below_mass_sd: float = 0.0
    below_center_sd: float = 0.0

    @property
    def exact(self) -> Self:
        """Return such sensors without errors; what is not known of their zeros remains."""
        none = (0.0,) * len(self.channels)
        without = {"repeatability": none, "noise": none, "resolution": none}
        return replace(self, **without, below_mass_sd=0.0, below_center_sd=0.0)

    def figures(self) -> list[Three]:
        """Return repeatability, noise and resolution of every channel."""
        count = len(self.channels)
        parts = (self.repeatability[:count], self.noise[:count], self.resolution[:count])
        return list(zip(*parts, strict=True))

    def only(self, channels: tuple[str, ...]) -> Self:
        """Return sensors of which only some channels are read."""
        kept = [self.channels.index(channel) for channel in channels]
        names = ("repeatability", "noise", "resolution", "zero_sd")
        figures = {name: tuple(getattr(self, name)[k] for k in kept) for name in names}
        return replace(self, channels=channels, **figures)


@dataclass(frozen=True)
class Sensors:
    """Data-sheet figures of the laboratory's sensors; all errors have zero mean.

    "repeatability" is drawn once per posture, so that averaging does not reduce it; "noise" is drawn per
    sample; "resolution" rounds every sample. While the robot moves, what is drawn once per posture changes
    as a stationary first-order process.

    Attributes:
        encoder_repeatability, encoder_noise, encoder_resolution: joint-side encoders [rad].
        motor_repeatability, motor_noise, motor_resolution: motor encoders over gear ratio [rad].
        cell_repeatability, cell_noise, cell_resolution: load cells [N].
        sample_rate: sample rate of every channel [Hz].
        placement_sd: s.d. of the recorded pose of the left plate, common to a placement's postures
            [m, m, rad].
        mark_sd: s.d. of the recorded pose of the right plate, whose foot stands on a mark [m, m, rad].
        weighed_mass_sd: s.d. of the scale that weighs the whole robot [kg].
        cell_gain: true gain of single cells by name; 1 if not named.
        changing_time: correlation time of "repeatability" while the robot moves [s].
        contact_lag: of the cells or wrench sensors behind the encoders [s].
        contact_filter: time constant of their first-order filter [s]; 0: none.
        wrench: wrench sensors; with them the plates' cells are not read, nor, if they are in the feet, the
            plates' poses. None: cells.
    """

    encoder_repeatability: float = 0.0
    encoder_noise: float = 0.0
    encoder_resolution: float = 0.0
    motor_repeatability: float = 0.0
    motor_noise: float = 0.0
    motor_resolution: float = 0.0
    cell_repeatability: float = 0.0
    cell_noise: float = 0.0
    cell_resolution: float = 0.0
    sample_rate: float = 100.0
    placement_sd: Pose = (0.0, 0.0, 0.0)
    mark_sd: Pose = (0.0, 0.0, 0.0)
    weighed_mass_sd: float = 0.0
    cell_gain: dict[str, float] = field(default_factory=dict)
    changing_time: float = CHANGING
    contact_lag: float = 0.0
    contact_filter: float = 0.0
    wrench: WrenchSensors | None = None

    @property
    def encoder(self) -> Three:
        """Return repeatability, noise and resolution of a joint's encoder [rad]."""
        return self.encoder_repeatability, self.encoder_noise, self.encoder_resolution

    @property
    def motor(self) -> Three:
        """Return the same of a motor's encoder [rad]."""
        return self.motor_repeatability, self.motor_noise, self.motor_resolution

    @property
    def cell(self) -> Three:
        """Return the same of a load cell [N]."""
        return self.cell_repeatability, self.cell_noise, self.cell_resolution


UNTARED: Six = (5.0, 5.0, 5.0, 0.2, 0.2, 0.2)  # N, Nm, s.d. of the zeros of a mounted sensor, assumed

FINE_ENCODERS = {  # of careful laboratories [rad]
    "encoder_repeatability": 1e-4,
    "encoder_noise": 1e-4,
    "encoder_resolution": 2 * np.pi / 2**16,
    "motor_repeatability": 1e-4,
    "motor_noise": 1e-4,
    "motor_resolution": 2 * np.pi / 2000 / 111,
}
COARSE_ENCODERS = {  # of ordinary ones [rad]
    "encoder_repeatability": 4e-4,
    "encoder_noise": 2e-4,
    "encoder_resolution": 2 * np.pi / 2**13,
    "motor_repeatability": 4e-4,
    "motor_noise": 2e-4,
    "motor_resolution": 2 * np.pi / 2000 / 111,
}
# Of the contact sensors while the robot moves [s]. An amplifier and its bus: a millisecond each, assumed. A
# board that reports by radio every 10 ms: the mean over a report is 5 ms late, its transport 10 ms, assumed.
WIRED = {"contact_lag": 0.001, "contact_filter": 0.001}
BY_RADIO = {"contact_lag": 0.010, "contact_filter": 0.005}
BY_JIG = {"placement_sd": (0.0004, 0.0004, 0.001), "mark_sd": (0.0001, 0.0001, 0.0005)}  # m, m, rad
BY_TAPE = {"placement_sd": (0.0035, 0.0035, 0.01), "mark_sd": (0.001, 0.001, 0.005)}
CAREFUL: dict[str, Any] = FINE_ENCODERS | WIRED | {"weighed_mass_sd": 0.005}
ORDINARY: dict[str, Any] = COARSE_ENCODERS | BY_RADIO | BY_TAPE | {"weighed_mass_sd": 0.02}
# ATI Mini45, calibration SI-580-20, without tare; docs/explanation/laboratory.md says where the figures are
# from.
MINI45 = WrenchSensors(
    repeatability=(0.58, 0.58, 1.16, 0.02, 0.02, 0.02),
    noise=(0.25, 0.25, 0.25, 1 / 188, 1 / 188, 1 / 376),
    resolution=(0.25, 0.25, 0.25, 1 / 188, 1 / 188, 1 / 376),
    zero_sd=UNTARED,
)
# A preset is a set of variance components without systematic effects; its lag is the same in all runs.
PRESETS: dict[str, Sensors] = {
    "ideal": Sensors(),
    # Research-grade plates and a placement jig: CoP residual below 0.5 mm per axis.
    "force-plate": Sensors(**CAREFUL, **BY_JIG, cell_repeatability=0.1, cell_noise=0.3, cell_resolution=0.01),
    # Wii balance boards: CoP residual sigma of 4.16 mm per axis, as in the paper.
    "wii": Sensors(**ORDINARY, cell_repeatability=1.43, cell_noise=1.5, cell_resolution=0.1),
    # Ankle sensors without errors but for their zeros, which are unknown.
    "foot-ideal": Sensors(wrench=WrenchSensors(zero_sd=UNTARED)),
    "foot-ft": Sensors(**CAREFUL, wrench=replace(MINI45, below_mass_sd=0.02, below_center_sd=0.002)),
    # The same sensor below the foot.
    "sole-ft": Sensors(**CAREFUL, wrench=replace(MINI45, place=SOLE)),
    # The same again, of which only what the centre of pressure needs is read.
    "sole-3axis": Sensors(**CAREFUL, wrench=replace(MINI45, place=SOLE).only(VERTICAL)),
    # Six-axis plates of AMTI's Optima kind, tared.
    "plate-ft": Sensors(
        **CAREFUL,
        **BY_JIG,
        wrench=WrenchSensors(
            place=PLATE,
            repeatability=(0.1, 0.1, 0.12, 0.024, 0.024, 0.012),
            noise=(0.3, 0.3, 0.3, 0.03, 0.03, 0.03),
            resolution=(0.05, 0.05, 0.1, 0.02, 0.02, 0.01),
        ),
    ),
    # Balance boards that hand over a centre of pressure and the vertical force: Bartlett et al. (2014).
    "plate-cop": Sensors(
        **ORDINARY,
        wrench=WrenchSensors(
            place=PLATE,
            channels=COP,
            repeatability=(0.0015, 0.0015, 4.5),
            noise=(0.001, 0.001, 1.5),
            resolution=(0.0001, 0.0001, 0.1),
        ),
    ),
}


def corrupted(
    signal: np.ndarray, noise: float, resolution: float, rng: np.random.Generator | np.random.RandomState
) -> np.ndarray:
    """Return one reading of every quantity in `signal` with noise and rounding, same shape."""
    readings = signal + noise * rng.standard_normal(signal.shape)
    return np.round(readings / resolution) * resolution if resolution > 0 else readings


def cell_gains(sensors: Sensors) -> np.ndarray:
    """Return the true gains of the eight cells in the order of `CELLS`, (8,)."""
    return np.array([sensors.cell_gain.get(cell, 1.0) for cell in CELLS])


def sample(
    truth: np.ndarray, figures: Three, samples: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw `samples` readings of constant quantities and return their mean and s.d., both (n,)."""
    repeatability, noise, resolution = figures
    offset = truth + repeatability * rng.standard_normal(truth.shape)
    readings = corrupted(np.broadcast_to(offset, (samples, *truth.shape)), noise, resolution, rng)
    return readings.mean(axis=0), readings.std(axis=0)


def sample_mean(
    truth: np.ndarray, figures: Three, samples: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Draw the mean and s.d. of `samples` readings directly from their distributions, both of any shape.

    The variance equals that of `sample` (see `averaged_sd`); only the shape of a rounding error without
    dither by noise differs.
    """
    _, noise, resolution = figures
    sd = averaged_sd(*figures, samples)
    spread = np.sqrt(noise**2 + resolution**2 / 12)
    scale = 1 + rng.standard_normal(truth.shape) / np.sqrt(2 * samples)
    return truth + sd * rng.standard_normal(truth.shape), spread * scale


def sample_series(
    truth: np.ndarray,
    figures: Three,
    samples: int,
    rng: np.random.Generator,
    interval: float,
    changing_time: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Draw one reading of every sample of a series, with errors that change slowly; NaN for the s.d.

    The true quantities are `interval` [s] apart, (n, ...), and "repeatability" has a correlation time of
    `changing_time` [s]. The number of samples is not used.
    """
    repeatability, noise, resolution = figures
    kept = np.exp(-interval / changing_time)
    steps = rng.standard_normal(truth.shape)
    steps[1:] *= np.sqrt(1 - kept**2)
    slow = np.asarray(scipy.signal.lfilter([1.0], [1.0, -kept], steps, axis=0))
    return corrupted(truth + repeatability * slow, noise, resolution, rng), np.full(truth.shape, np.nan)


def delayed(sensors: Sensors, series: np.ndarray, interval: float) -> np.ndarray:
    """Return what the contact sensors pass on of a series, (n, ...): late, and through their filter.

    Both are exact for a signal that is straight between its samples.
    """
    if not series.size:  # no such sensors
        return series
    time = interval * np.arange(len(series))
    flat = series.reshape(len(series), -1)
    late = np.column_stack([np.interp(time - sensors.contact_lag, time, column) for column in flat.T])
    if sensors.contact_filter > 0:
        ratio = sensors.contact_filter / interval
        kept = np.exp(-1 / ratio)
        new, old = 1 - ratio * (1 - kept), ratio * (1 - kept) - kept
        at_rest = (old + kept) * late[:1]
        late, _ = scipy.signal.lfilter([new, old], [1.0, -kept], late, axis=0, zi=at_rest)
    return late.reshape(series.shape)


def draw_zeros(sensors: WrenchSensors, rng: np.random.Generator) -> np.ndarray:
    """Draw the true zeros of both wrench sensors for one experiment, (2, c) [N, Nm]."""
    count = len(sensors.channels)
    return np.array(sensors.zero_sd[:count]) * rng.standard_normal((2, count))


def read_wrenches(
    sensors: WrenchSensors,
    wrenches: np.ndarray,
    zeros: np.ndarray,
    samples: int,
    rng: np.random.Generator,
    sample: Sampling = sample,
) -> tuple[np.ndarray, np.ndarray]:
    """Read the wrench sensors: mean and s.d. over a window, each (..., 2, c) [N, Nm]; of `COP` [m, m, N].

    Args:
        wrenches: true wrenches in the sensors' frames, (..., 2, 6). zeros: see `draw_zeros`.
    """
    names = VERTICAL if sensors.channels == COP else sensors.channels
    given = wrenches[..., [WRENCH.index(name) for name in names]]
    given = cops_of_wrenches(given) if sensors.channels == COP else given
    channels = np.moveaxis(given + zeros, -1, 0)
    read = [
        sample(true, figure, samples, rng) for true, figure in zip(channels, sensors.figures(), strict=True)
    ]
    return np.stack([mean for mean, _ in read], axis=-1), np.stack([sd for _, sd in read], axis=-1)


def averaged_sd(repeatability: float, noise: float, resolution: float, samples: int) -> float:
    """Return the s.d. of a posture's averaged reading, as on a data sheet.

    Rounding a constant signal adds the variance resolution^2 / 12; noise dithers it away (Widrow's series).
    """
    variance = repeatability**2 + noise**2 / samples
    if resolution > 0:
        k = np.arange(1, 2000)
        dither = np.exp(-2 * (np.pi * k * noise / resolution) ** 2) ** 2
        variance += (resolution**2 / (2 * np.pi**2 * k**2) * dither).sum()
    return float(np.sqrt(variance))
