"""Logs in text, folders and archives, each in the layout of the program that writes it.

A writer is given a path without its end, times in whole microseconds from zero, and the
readings of an accelerometer, a gyroscope and a magnetometer, and returns the path of
what it made. The source of each layout stands beside it.
"""

import csv
import io
import json
import zipfile

import numpy as np

EPOCH = 1_700_000_000_987_000_000  # ns; a log of half a second crosses a whole second
NAMES = ("ax", "ay", "az", "gx", "gy", "gz")
XYZ = "xyz"


def table(header, *columns):
    """Rows below a header that may be empty, all digits, by the csv module."""
    parts = [
        np.asarray(column).reshape(len(columns[0]), -1).tolist() for column in columns
    ]
    rows = ([v for part in row for v in part] for row in zip(*parts, strict=True))
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(
        [*([header] if header else []), *rows]
    )
    return out.getvalue()


def saved(path, text):
    path.write_text(text, encoding="utf-8")
    return path


def echo(path, us, force, rate, field):
    """https://github.com/ros2/rosidl_runtime_py, convert.py, message_to_csv."""
    ns = EPOCH + 1000 * us
    four, nine = np.tile([0.0, 0.0, 0.0, 1.0], (len(us), 1)), np.zeros((len(us), 9))
    name = np.full(len(us), "imu_link")
    text = table((), ns // 10**9, ns % 10**9, name, four, nine, rate, nine, force, nine)
    return saved(path.with_suffix(".csv"), text)


def rostopic(path, us, force, rate, field):
    """https://wiki.ros.org/rostopic#rostopic_echo, option -p."""
    ns, k = EPOCH + 1000 * us, np.arange(len(us))
    header = ["%time", "field.header.seq", "field.header.stamp",
              "field.header.frame_id",
              *(f"field.orientation.{a}" for a in "xyzw"),
              *(f"field.angular_velocity.{a}" for a in XYZ),
              *(f"field.linear_acceleration.{a}" for a in XYZ),
              *(f"field.linear_acceleration_covariance{k}" for k in range(9)),
              ]  # fmt: skip
    name, four, nine = (
        np.full(len(us), "imu"),
        np.zeros((len(us), 4)),
        np.zeros((len(us), 9)),
    )
    text = table(header, ns, k, ns - 100, name, four, rate, force, nine)
    return saved(path.with_suffix(".csv"), text)


def combined(path, us, force, rate, field):
    """https://github.com/PX4/pyulog, ulog2csv.py, of the topic sensor_combined."""
    header = ["timestamp", *(f"gyro_rad[{k}]" for k in range(3)), "gyro_integral_dt",
              "accelerometer_timestamp_relative",
              *(f"accelerometer_m_s2[{k}]" for k in range(3))]  # fmt: skip
    dt = np.full(len(us), 10_000)
    text = table(header, 180_000_000 + us, rate, dt, 0 * us, force)
    return saved(path.with_suffix(".csv"), text)


def arrived(us, lines):
    """https://docs.arduino.cc/software/ide-v2/tutorials/ide-v2-serial-monitor/."""
    day = (86_399_700 + np.rint(us / 1000).astype(int)) % 86_400_000  # past midnight
    clock = [
        f"{t // 3_600_000:02d}:{t // 60_000 % 60:02d}:{t % 60_000 / 1000:06.3f}"
        for t in day
    ]
    return "".join(f"{t} -> {line}\n" for t, line in zip(clock, lines, strict=True))


def numbers(force, rate, *first):
    return np.column_stack([*first, force, rate]).tolist()


def plotter(path, us, force, rate, field):
    """https://docs.arduino.cc/software/ide-v2/tutorials/ide-v2-serial-plotter/."""
    lines = [
        ",".join(f"{n}:{v}" for n, v in zip(NAMES, row, strict=True))
        for row in numbers(force, rate)
    ]
    return saved(path.with_suffix(".txt"), arrived(us, lines))


def monitor(path, us, force, rate, field):
    """As `arrived`, of rows below a line of names."""
    lines = [
        "MPU6050 found",
        ",".join(NAMES),
        *(",".join(map(str, row)) for row in numbers(force, rate)),
    ]
    return saved(path.with_suffix(".txt"), arrived(np.r_[us[:1], us[:1], us], lines))


def bare_monitor(path, us, force, rate, field):
    """As `arrived`, of rows alone."""
    lines = ["\t".join(map(str, row)) for row in numbers(force, rate)]
    return saved(path.with_suffix(".txt"), arrived(us, lines))


def objects(path, us, force, rate, field):
    """https://jsonlines.org."""
    rows = [
        dict(zip(("us", *NAMES), row, strict=True)) for row in numbers(force, rate, us)
    ]
    return saved(
        path.with_suffix(".jsonl"), "".join(f"{json.dumps(row)}\n" for row in rows)
    )


def sensorlog(path, us, force, rate, field):
    """http://sensorlog.berndthomas.net, its example files of an iPhone."""
    header = ["loggingTime(txt)", "loggingSample(N)", "locationTimestamp_since1970(s)",
              "accelerometerTimestamp_sinceReboot(s)",
              *(f"accelerometerAcceleration{a}(G)" for a in "XYZ"),
              "gyroTimestamp_sinceReboot(s)",
              *(f"gyroRotation{a}(rad/s)" for a in "XYZ"),
              *(f"motionUserAcceleration{a}(G)" for a in "XYZ"),
              *(f"motionRotationRate{a}(rad/s)" for a in "XYZ"),
              *(f"magnetometer{a}(µT)" for a in "XYZ")]  # fmt: skip
    texts = [f"2026-11-23 10:00:{t / 1e6:06.3f} +0100" for t in us % 60_000_000]
    fixed = np.full(len(us), 1.7e9)
    text = table(header, texts, np.arange(len(us)), fixed, us / 1e6, force, us / 1e6,
                 rate, 0 * force, 9 + 0 * rate, field)  # fmt: skip
    return saved(path.with_suffix(".csv"), text)


def folder(path, files):
    for name, text in files.items():
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        saved(path / name, text)
    return path


def archive(path, files):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, text in files.items():
            file.writestr(name, text)
    return path


def attitudes(us):
    """Quaternions, scalar first, of a data set's truth."""
    q = np.random.default_rng(len(us)).normal(size=(len(us), 4))
    return q / np.linalg.norm(q, axis=1)[:, None]


POSE = [
    "#timestamp [ns]",
    *(f" p_RS_R_{a} [m]" for a in XYZ),
    *(f" q_RS_{a} []" for a in "wxyz"),
]


def euroc(path, us, force, rate, field, q=None):
    """https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets."""
    ns, q = EPOCH + 1000 * us, attitudes(us) if q is None else q
    imu = ["#timestamp [ns]", *(f"w_RS_S_{a} [rad s^-1]" for a in XYZ),
           *(f"a_RS_S_{a} [m s^-2]" for a in XYZ)]  # fmt: skip
    truth = ["#timestamp", *POSE[1:], *(f" v_RS_R_{a} [m s^-1]" for a in XYZ),
             *(f" b_w_RS_S_{a} [rad s^-1]" for a in XYZ),
             *(f" b_a_RS_S_{a} [m s^-2]" for a in XYZ)]  # fmt: skip
    return folder(path, {
        "mav0/body.yaml": "comment: body",
        "mav0/cam0/data.csv": "#timestamp [ns],filename\n1,1.png\n",
        "mav0/imu0/data.csv": table(imu, ns, rate, force),
        "mav0/imu0/sensor.yaml": "sensor_type: imu\nrate_hz: 200\n",
        "mav0/state_groundtruth_estimate0/data.csv": table(
            truth, ns, force, q, force, force, force),
    })  # fmt: skip


def tum_vi(path, us, force, rate, field):
    """https://cvg.cit.tum.de/data/datasets/visual-inertial-dataset, EuRoC's format."""
    euroc(path / "dataset-room1", us, force, rate, field)
    mav = path / "dataset-room1" / "mav0"
    (mav / "state_groundtruth_estimate0").rename(mav / "mocap0")
    text = table(POSE, EPOCH + 1000 * us, force, attitudes(us))
    saved(mav / "mocap0" / "data.csv", text)
    return path


def phone(us, values):
    """https://github.com/tszheichoi/awesome-sensor-logger/blob/main/UNITS.md."""
    header = ["time", "seconds_elapsed", *values]
    return table(header, EPOCH + 1000 * us, us / 1e6, *values.values())


def axes(values):
    return dict(zip("zyx", values.T[::-1], strict=True))


def android(path, us, force, rate, field):
    """As `phone`."""
    text = "version,device name,platform\n3,phone,android\n"
    notes = "time,seconds_elapsed,text,millisecond_press_duration\n"
    return archive(path.with_suffix(".zip"), {
        "Metadata.csv": text, "Annotation.csv": notes,
        "Accelerometer.csv": phone(us, axes(0 * force)),
        "Gravity.csv": phone(us, axes(force)),
        "TotalAcceleration.csv": phone(us, axes(force)),
        "Gyroscope.csv": phone(us, axes(rate)),
        "Magnetometer.csv": phone(us, axes(field)),
    })  # fmt: skip


def iphone(path, us, force, rate, field):
    """As `phone`."""
    return folder(path, {
        "Accelerometer.csv": phone(us, axes(0 * force)),
        "AccelerometerUncalibrated.csv": phone(us, axes(force)),
        "Gyroscope.csv": phone(us, axes(rate)),
        "Magnetometer.csv": phone(us, axes(field)),
    })  # fmt: skip


def phyphox(path, us, force, rate, field):
    """https://phyphox.org/wiki/index.php/Experiment:_Acceleration_(with_g), exports."""

    def part(unit, values):
        return table(["Time (s)", *(f"{a} ({unit})" for a in "XYZ")], us / 1e6, values)

    return archive(path.with_suffix(".zip"), {
        "Accelerometer.csv": part("m/s^2", force),
        "Gyroscope.csv": part("rad/s", rate),
        "Linear Acceleration.csv": part("m/s^2", 0 * force),
        "Magnetometer.csv": part("µT", field),
        "meta/device.csv": '"property","value"\n"version","1.1.16"\n',
        "meta/time.csv": '"event","experiment time","system time"\n"START",0,1.7e9\n',
    })  # fmt: skip


def ulog2csv(path, us, force, rate, field):
    """As `combined`; fields of https://github.com/PX4/px4_msgs, SensorAccel.msg."""

    def part(values):
        header = ["timestamp", "timestamp_sample", "device_id", *XYZ, "temperature"]
        warm = np.full(len(us), 31.5)
        return table(header, 5_000_000 + us, 5_000_000 + us, 0 * us, values, warm)

    return folder(path, {
        "log_1_sensor_accel_0.csv": part(force),
        "log_1_sensor_gyro_0.csv": part(rate),
        "log_1_sensor_mag_0.csv": part(field),
        "log_1_cpuload_0.csv": table(["timestamp", "load"], us, 0.0 * us),
    })  # fmt: skip


def lines(*rows, mark=","):
    """Text of rows of fields."""
    return "".join(mark.join(map(str, row)) + "\n" for row in rows)


def axes_of(*words):
    return [f"{word}_{a}" for word in words for a in "XYZ"]


def mt_manager(path, us, force, rate, field):
    """Export of Xsens MT Manager 4: the clocks of an MTw are empty fields."""
    clocks = ["SampleTimeFine", "Year", "Month", "Day", "Second"]
    above = ["// Start Time: Unknown", f"// Update Rate: {1e6 / np.diff(us)[0]}Hz",
             "// Filter Profile: human (46.1)"]  # fmt: skip
    rows = numbers(force, rate, field)
    header = ["PacketCounter", *clocks, *axes_of("Mag", "Acc", "Gyr")]
    body = ([f"{k + 400:05d}", *[""] * 5, *row] for k, row in enumerate(rows))
    text = "\n".join([*above, lines(header, *body, mark="\t")])
    return saved(path.with_suffix(".txt"), text)


def mt_manager_2022(path, us, force, rate, field):
    """As `mt_manager`, version 2022: NaN and a separator at the end of the header."""
    text = mt_manager(path, us, force, rate, field).read_text()
    text = text.replace("\t\t\t\t\t\t", "\tNaN\tNaN\tNaN\tNaN\tNaN\t")
    return saved(path.with_suffix(".txt"), text.replace("Gyr_Z", "Gyr_Z\t"))


def movella_dot(path, us, force, rate, field):
    """Export of the Movella DOT app: microseconds, a separator behind each row."""
    above = ["DeviceTag:,Xsens DOT", "OutputRate:,100Hz", "FilterProfile:,General", ""]
    header = [
        "PacketCounter",
        "SampleTimeFine",
        *axes_of("Acc", "Gyr", "Mag"),
        "Status",
    ]
    body = zip(range(1, len(us) + 1), 192_856_375 + us, strict=True)
    rows = zip(body, numbers(force, rate), field.tolist(), strict=True)
    text = lines(header, *([*a, *b, *c, 0, ""] for a, b, c in rows))
    return saved(path.with_suffix(".csv"), "\n".join([*above, text]))


def moveo(path, us, force, rate, field):
    """Export of APDM Moveo Explorer: a row of units, one of them of no axis."""
    above = lines(["Test Name:", "Poses", *[""] * 10], ["Sample Rate:", 100, "Hz"])
    names = [f"Lumbar/{s}/{a}" for s in ("Acceleration", "Angular Velocity",
             "Magnetic Field") for a in "XYZ"]  # fmt: skip
    units = ["s", *["m/s^2"] * 3, *["rad/s"] * 3, *["uT"] * 3, "kPa"]
    rows = np.column_stack([us / 1e6, force, rate, field, 101.3 + 0 * us]).tolist()
    text = lines(["Time", *names, "Lumbar/Barometer"], units, *rows)
    return saved(path.with_suffix(".csv"), above + text)


def sensor_connect(path, us, force, rate, field):
    """Export of MicroStrain SensorConnect: each sensor in its own rows, US dates."""
    start = np.datetime64("2026-01-30T23:59:59.9", "us")
    dates = [str(start + np.timedelta64(t, "us")) for t in us.tolist()]
    stamps = [f"{d[5:7]}/{d[8:10]}/{d[:4]} {d[11:]}" for d in dates]
    names = [f"inertial-6251.118903:scaled{s}{a}" for s in ("Accel", "Gyro", "Mag")
             for a in "XYZ"]  # fmt: skip
    parts = force.tolist(), rate.tolist(), field.tolist()
    rows = []
    for stamp, a, w, m in zip(stamps, *parts, strict=True):
        none = [""] * 3
        rows += [[stamp, *a, *none, *none], [stamp, *none, *w, *none],
                 [stamp, *none, *none, *m]]  # fmt: skip
    return saved(path.with_suffix(".csv"), lines(["Time", *names], *rows))


def consensys(path, us, force, rate, field):
    """Export of Shimmer Consensys: device, name, form and unit, a tab behind each."""
    names = [f"{s} {a}" for s in ("Low Noise Accelerometer", "Gyroscope",
             "Magnetometer") for a in "XYZ"]  # fmt: skip
    units = ["mSecs", *["m/(sec^2)*"] * 3, *["deg/sec*"] * 3, *["local*"] * 3]
    head = [["Shimmer_5E6C"] * 10, ["Timestamp", *names], ["CAL"] * 10, units]
    rows = np.column_stack([us / 1e3, force, rate, field]).tolist()
    text = lines(*([*row, ""] for row in (*head, *rows)), mark="\t")
    return saved(path.with_suffix(".csv"), text)


def r_table(path, us, force, rate, field):
    """https://stat.ethz.ch/R-manual/R-devel/library/utils/html/write.table.html."""
    header = [f'"{name}"' for name in ("t", *NAMES)]
    rows = numbers(force, rate, us / 1e6)
    body = ([f'"{k}"', *row] for k, row in enumerate(rows, start=1))
    return saved(path.with_suffix(".txt"), lines(header, *body, mark=" "))


def date_and_time(path, us, force, rate, field):
    """Two columns of clock, as many data loggers have, with 12 hours and a word."""
    texts = [f"11:59:{58 + t / 1e6:09.6f} AM" for t in us.tolist()]
    names = [f"{s} ({a})" for s in ("Acceleration", "Angular velocity") for a in "xyz"]
    rows = zip(texts, numbers(force, rate), strict=True)
    text = lines(["Date", "Time", *names], *(["1/30/2026", t, *row] for t, row in rows))
    return saved(path.with_suffix(".csv"), text)


SIX = (echo, rostopic, combined, plotter, monitor, bare_monitor, objects, euroc, tum_vi,
       r_table, date_and_time)  # fmt: skip
NINE = (sensorlog, android, iphone, phyphox, ulog2csv, mt_manager, mt_manager_2022,
        movella_dot, moveo, sensor_connect, consensys)  # fmt: skip
FORMS = {writer.__name__: writer for writer in (*SIX, *NINE)}
