"""The library under test: sensors, their calibration, attitude, filters, logs.

It imports nothing of what tests it (scenes, theory, studies, plug-ins, sweeps, judge,
report), and could be used alone: `sensor` distorts readings and corrects them,
`calibrate` recovers what distorted them, `attitude` and `filters` tell how a body is
turned, `noise` and `statics` describe readings, `logs`, `multiposition` and `recorded`
go from a file to an answer.
"""
