"""Random spellings of one log: what loggers write, and what they should not."""

from dataclasses import dataclass

import numpy as np

ACCELEROMETERS = [  # names of x, y, z; each is used with any of the units
    ("ax", "ay", "az"),
    ("Ax", "Ay", "Az"),
    ("acc_x", "acc_y", "acc_z"),
    ("AccX", "AccY", "AccZ"),
    ("Acc_X", "Acc_Y", "Acc_Z"),
    ("accel_x", "accel_y", "accel_z"),
    ("Accel X", "Accel Y", "Accel Z"),
    ("accelX", "accelY", "accelZ"),
    ("xacc", "yacc", "zacc"),
    ("Acceleration x", "Acceleration y", "Acceleration z"),
    ("X-axis acceleration", "Y-axis acceleration", "Z-axis acceleration"),
    ("accelerometer_x", "accelerometer_y", "accelerometer_z"),
    ("imu/acc.x", "imu/acc.y", "imu/acc.z"),
    ("linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"),
    ("field.linear_acceleration.x", "field.linear_acceleration.y",
     "field.linear_acceleration.z"),
    ("a_RS_S_x", "a_RS_S_y", "a_RS_S_z"),
    ("gFx", "gFy", "gFz"),
    ("GForceX", "GForceY", "GForceZ"),
    ("Acceleration (x)", "Acceleration (y)", "Acceleration (z)"),
    ("acceleration_x_gs", "acceleration_y_gs", "acceleration_z_gs"),
    ("Low Noise Accelerometer X", "Low Noise Accelerometer Y",
     "Low Noise Accelerometer Z"),
    ("accelerometerAccelerationX", "accelerometerAccelerationY",
     "accelerometerAccelerationZ"),
    ("TotalAcceleration_x", "TotalAcceleration_y", "TotalAcceleration_z"),
]  # fmt: skip
UNITS = ["", " [m/s^2]", " (m/s²)", " [g]", "[raw]", " (G)"]
GYROS = [
    ("wx", "wy", "wz"),
    ("gx", "gy", "gz"),
    ("gyr_x", "gyr_y", "gyr_z"),
    ("GyrX", "GyrY", "GyrZ"),
    ("Gyr_X", "Gyr_Y", "Gyr_Z"),
    ("gyro_x [rad/s]", "gyro_y [rad/s]", "gyro_z [rad/s]"),
    ("Gyroscope x (°/s)", "Gyroscope y (°/s)", "Gyroscope z (°/s)"),
    ("angular_velocity.x", "angular_velocity.y", "angular_velocity.z"),
    (
        "angular_rate_x_deg_per_s",
        "angular_rate_y_deg_per_s",
        "angular_rate_z_deg_per_s",
    ),
    ("Gyroscope (X) [°/s]", "Gyroscope (Y) [°/s]", "Gyroscope (Z) [°/s]"),
]
OTHERS = [  # never the accelerometer's
    ("mx", "my", "mz"),
    ("mag_x", "mag_y", "mag_z"),
    ("Mag_X", "Mag_Y", "Mag_Z"),
    ("Magnetic field x (µT)", "Magnetic field y (µT)", "Magnetic field z (µT)"),
    ("Linear Acceleration x", "Linear Acceleration y", "Linear Acceleration z"),
    ("FreeAcc_X", "FreeAcc_Y", "FreeAcc_Z"),
    ("userAcceleration.x", "userAcceleration.y", "userAcceleration.z"),
    ("gravity_x", "gravity_y", "gravity_z"),
    ("lin_acc_x", "lin_acc_y", "lin_acc_z"),
    ("acc_bias_x", "acc_bias_y", "acc_bias_z"),
    ("angular_velocity_covariance0", "angular_velocity_covariance1", "q"),
    ("Roll", "Pitch", "Yaw"),
    ("qx", "qy", "qz"),
]
SINGLES = [
    "temperature",
    "barometer [kPa]",
    "Temp [°C]",
    "seq",
    "PacketCounter",
    "pressure (hPa)",
    "rest",
]
CLOCKS = [  # name, seconds in a unit of it
    ("t", 1.0), ("time", 1.0), ("Time (s)", 1.0), ("timestamp [s]", 1.0),
    ("seconds_elapsed", 1.0), ("time_ms", 1e-3), ("t [ms]", 1e-3), ("millis", 1e-3),
    ("Timestamp (ms)", 1e-3), ("TimeUS", 1e-6), ("time [us]", 1e-6), ("t [µs]", 1e-6),
    ("timestamp [ns]", 1e-9), ("time_ns", 1e-9), ("elapsed (nanoseconds)", 1e-9),
]  # fmt: skip
SEPARATORS = ["\t", ";", "; ", ",", ", ", " ", "   ", "|"]
PREAMBLES = [
    [],
    ["# made by hand", "# 2024-03-01"],
    ["% MATLAB export"],
    ["// Start Time: Unknown", "// Sample rate: 100.0Hz"],
    ["Logger v2.1", "Serial ABC-17"],
    ["Fs,100", "Logging Type,1"],
    ["Device: phone", ""],
]
ENCODINGS = ["utf-8", "utf-8-sig", "cp1252", "utf-16"]


@dataclass(frozen=True)
class Spelling:
    """One file: its bytes, and what must be read from it."""

    content: bytes
    header: list[str]
    time: np.ndarray
    force: np.ndarray
    gyro: np.ndarray | None


def pick(rng, choices):
    return choices[int(rng.integers(len(choices)))]


def rows(rng, n=24):
    """Time, readings and angular rates of a log, of numbers that print exactly."""
    time = np.round(np.arange(n) / pick(rng, [10, 25, 50, 100, 400, 1000]), 6)
    return (
        time,
        np.round(rng.normal(size=(n, 3)) * 9, 6),
        np.round(rng.normal(size=(n, 3)), 6),
    )


def columns(rng, time, force, gyro, accelerometer=True):
    """Blocks of named columns in random order; whether a gyro is among them."""
    clock, second = pick(rng, CLOCKS)
    blocks = [[(clock, np.round(time / second, 6))]]
    if accelerometer:
        unit = pick(rng, UNITS)
        names = pick(rng, ACCELEROMETERS)
        if names[0].endswith(".x"):
            unit = ""  # a message's path has none
        blocks.append([(n + unit, force[:, k]) for k, n in enumerate(names)])
    has_gyro = bool(rng.random() < 0.5)
    if has_gyro:
        blocks.append([(n, gyro[:, k]) for k, n in enumerate(pick(rng, GYROS))])
    for names in [pick(rng, OTHERS)] * int(rng.random() < 0.6):
        blocks.append([(n, np.round(rng.normal(size=len(time)), 4)) for n in names])
    if rng.random() < 0.5:
        blocks.append([(pick(rng, SINGLES), np.round(rng.normal(size=len(time)), 3))])
    if rng.random() < 0.4:
        label = np.full(len(time), pick(rng, ["walk", "2024-03-01T10:00:00.5Z", "a-b"]))
        blocks.append([("label", label)])
    order = rng.permutation(len(blocks))
    return [column for k in order for column in blocks[k]], has_gyro


def spelled(rng, accelerometer=True):
    """Return a random file that is read, or refused without its accelerometer."""
    time, force, gyro = rows(rng)
    table, has_gyro = columns(rng, time, force, gyro, accelerometer)
    separator = pick(rng, SEPARATORS)
    header = [name for name, _ in table]
    if not separator.strip(" "):  # blanks separate: none in a name but before a unit
        header = [
            name.replace(" (", "(").replace(" [", "[").replace(" ", "_")
            for name in header
        ]
    comma = separator.strip() != "," and bool(rng.random() < 0.4)
    quoted = separator.strip() != "" and bool(rng.random() < 0.2)
    lines = list(pick(rng, PREAMBLES))
    mark = pick(rng, ["", "", "", "# ", "%"])
    shown = [f'"{name}"' for name in header] if quoted and not mark else header
    lines.append(mark + separator.join(shown))
    for row in zip(*(values for _, values in table), strict=True):
        texts = [v if isinstance(v, str) else f"{v:.6f}" for v in row]
        if comma:
            texts = [
                t if t[0].isalpha() or "T" in t else t.replace(".", ",") for t in texts
            ]
        lines.append(separator.join(texts))
    text = pick(rng, ["\n", "\r\n"]).join(lines) + pick(rng, ["", "\n", "\n\n"])
    content = text.encode(pick(rng, ENCODINGS))
    return Spelling(content, header, time, force, gyro if has_gyro else None)
