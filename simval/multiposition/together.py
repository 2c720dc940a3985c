"""Three sensors of a log in one fit, each with the noise that its residuals show."""

import numpy as np

from simval.arrays import Array
from simval.calibrate import ImuFit, MagnetometerFit, NineAxisFit
from simval.errors import RefusedError
from simval.shapes import Float


def fit_together(
    imu: ImuFit,
    compass: MagnetometerFit,
    fields: Float[Array, "n 3"],
    field_std: Float[Array, " n"],
) -> tuple[NineAxisFit, tuple[str, ...]]:
    """Fit three sensors from the fits of two each, and say what was taken for noise.

    A sensor whose residuals are beyond what its noise explains by chance would pull
    the others out of place: it goes in with the noise that they show.

    Raises
    ------
    RefusedError
        If no step leads from the fits of two sensors to one of all, or one of all is
        beyond what even these noises explain.
    """
    from simval.calibrate import calibrate_nine_axis

    own, reduced = imu.gyroscope, imu.reduced
    turned = _excess(float(own.chi2_per_dof) * own.dof, own.dof)
    scattered = _excess(float(compass.chi_square), compass.dof)
    fit = calibrate_nine_axis(
        reduced.moves,
        reduced.poses,
        fields,
        own,
        compass,
        pose_std=reduced.pose_std,
        field_std=field_std * scattered,
        angle_random_walk=reduced.angle_random_walk * turned,
        bias_random_walk=reduced.bias_random_walk,
        known_bias=reduced.known_bias,
        bias_std=reduced.bias_std * turned,
    ).require_converged()
    ratio = float(fit.chi2_per_dof)
    if _excess(ratio * fit.dof, fit.dof) > 1.0:
        msg = (
            f"chi-square per degree of freedom would be {ratio:.3g} with {fit.dof}, "
            "though each fits beside the accelerometer: the turns of the gyroscope and "
            "those of the field disagree; look for iron that moves with the sensor, "
            "for a reading in coarse steps, and at the time of both sensors"
        )
        raise RefusedError(msg)
    factors = {"gyroscope": turned, "magnetometer": scattered}
    return fit, tuple(
        f"noise of the {name}: {factor:.2f} times what its rests show, as its "
        "residuals ask"
        for name, factor in factors.items()
        if factor > 1.0
    )


def _excess(chi_square: float, dof: int) -> float:
    # by how much residuals exceed the noise, 1 where chance can
    from simval.calibrate.magnetometer.summary import seen_over_stated

    return float(seen_over_stated(np.array([chi_square]), dof)[0])
