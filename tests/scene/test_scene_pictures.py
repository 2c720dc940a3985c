"""Pictures of a scene: arrows where they belong, and the directions visited.

What a picture is drawn from is tested without graphics; the tests of pixels skip where
the machine cannot draw.
"""

import importlib.util
import io

import mujoco
import numpy as np
import pytest
from PIL import Image

from simval.errors import InputError
from simval.geometry import attitude_matrix
from simval.scene import pictures, render, render_file, scenes, simulate
from simval.scene.captions import (
    Caption,
    Directions,
    captioned,
)
from simval.scene.catalogue import find_scene
from simval.scene.draw import (
    AXES,
    AXIS_LENGTH,
    CAMERA,
    FORCE,
    FORCE_LENGTH,
    LONGEST,
    arrow_tips,
    body_reach,
)
from simval.scene.physics import load_model, model_path, roll_out
from simval.scene.pictures import Frame
from simval.scene.run import write_script

SHORT = {"poses": 3, "first_hold": 0.3, "hold_time": 0.2, "move_time": 0.3}


@pytest.fixture(scope="module")
def gimbal():
    model = load_model(model_path("gimbal")).model
    data = mujoco.MjData(model)
    data.qpos[:] = [0.3, -0.4, 0.7]
    mujoco.mj_forward(model, data)
    return model, data


def test_the_arrows_are_the_sensors_axes_and_its_force(gimbal):
    """Against the attitude by MuJoCo's own sensor, not the site's matrix."""
    model, data = gimbal
    scalar_first = data.sensor("attitude").data
    R_sw = attitude_matrix(np.roll(scalar_first, -1))
    felt = R_sw @ [1.0, -2.0, 9.80665]
    reach = body_reach(model)
    tips = arrow_tips(data, felt, 9.80665, reach) - data.site("imu").xpos
    for axis in range(3):
        # unit vectors of products of three rotations: some ten roundings
        np.testing.assert_allclose(
            tips[axis] / (AXIS_LENGTH * reach), R_sw[axis], rtol=0, atol=1e-14
        )
    felt_w = R_sw.T @ felt / 9.80665
    np.testing.assert_allclose(tips[3], FORCE_LENGTH * reach * felt_w, atol=1e-14)


@pytest.mark.parametrize(("size", "shown"), [(0.0, 0.0), (2.0, 2.0), (2000.0, LONGEST)])
def test_an_impact_stays_in_the_picture(gimbal, size, shown):
    _, data = gimbal
    tips = arrow_tips(data, np.array([0.0, -size, 0.0]), 1.0, 0.1)
    length = np.linalg.norm(tips[3] - data.site("imu").xpos)
    np.testing.assert_allclose(length, 0.1 * FORCE_LENGTH * shown, rtol=1e-14)


def test_positions_and_readings_are_of_one_instant():
    scene = find_scene("gimbal")
    physics = load_model(scene.model)
    script = write_script(scene, physics, {"poses": 2, "move_time": 0.2})
    rollout = roll_out(physics.model, [script], positions=True)
    qpos, rows = rollout.qpos[0], rollout.rows[0]
    trajectory = simulate("gimbal", poses=2, move_time=0.2)
    np.testing.assert_array_equal(rows[:, :3], trajectory.specific_force)
    data = mujoco.MjData(physics.model)
    for k in (0, 540, len(rows) - 1):  # of rest, of the move after a second, of rest
        data.qpos[:] = qpos[k]
        mujoco.mj_forward(physics.model, data)
        turned = np.abs(data.sensor("attitude").data @ rows[k, 9:13])
        # cosine of half the turn between them: 1 but for rounding
        np.testing.assert_allclose(turned, 1.0, rtol=0, atol=1e-15 * 8)


def count_of(pixels, colour):
    wanted = np.array([*bytes.fromhex(colour[1:])], int)
    return int((np.abs(pixels.astype(int) - wanted).max(axis=-1) < 12).sum())


def blank(places):
    pixels = np.full((720, 960, 3), 128, np.uint8)
    return Frame(pixels=pixels, places=np.asarray(places, float))


CROSS = [[480, 360], [600, 360], [480, 460], [400, 300], [480, 200]]


def caption(visited=2, now=(0.0, 0.0, 1.0)):
    # towards the eye, off the axes
    rests = np.array([[0.8, 0, 0.6], [0.6, 0.8, 0], [0, 0.8, 0.6], [0.8, 0, -0.6]])
    directions = Directions(
        rests=rests, visited=np.arange(4) < visited, now=np.array(now)
    )
    return Caption(
        title="a scene", time=12.3, force=9.8 * np.array(now), directions=directions
    )


def test_each_arrow_has_its_letter_at_its_tip():
    drawn = captioned(blank(CROSS), caption())
    for (x, y), (sx, sy), colour in zip(
        CROSS[1:], [CROSS[0]] * 4, (*AXES, FORCE), strict=True
    ):
        beyond = np.array([x - sx, y - sy]) / np.hypot(x - sx, y - sy)
        cx, cy = (np.array([x, y]) + 17 * beyond).astype(int)
        assert count_of(drawn[cy - 14 : cy + 14, cx - 12 : cx + 12], colour) > 15
    # power: without the tips there is no letter there
    nowhere = [CROSS[0]] + [[np.nan, np.nan]] * 4
    without = captioned(blank(nowhere), caption())
    assert count_of(without[346:374, 605:630], AXES[0]) == 0


@pytest.fixture(scope="module")
def drawable():
    try:
        return render("gimbal", **SHORT)
    except InputError as error:
        pytest.skip(f"no picture can be drawn here: {error}")


@pytest.mark.ci
def test_a_picture_shows_the_body_in_the_same_bytes(drawable):
    assert render("gimbal", **SHORT) == drawable
    with Image.open(io.BytesIO(drawable)) as image:
        pixels = np.asarray(image.convert("RGB")).astype(int)
    assert pixels.shape == (720, 960, 3)
    red, green, blue = pixels[200:450, 300:700].transpose(2, 0, 1)
    glass = (red - blue > 60) & (green - blue > 15)  # the IMU's box, orange glass
    assert 3000 < glass.sum() < 40_000


@pytest.mark.ci
def test_an_animation_has_its_frames_and_moves(drawable, tmp_path):
    path, short = tmp_path / "gimbal.gif", {"poses": 2, "first_hold": 0.2}
    render_file(path, "gimbal", seconds=1.0, width=160, height=120, **short)
    with Image.open(path) as film:
        assert film.n_frames >= 10  # 1 s at 15 Hz, equal neighbours may be merged
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(film.n_frames - 1)
        last = np.asarray(film.convert("RGB")).astype(int)
    assert (np.abs(first - last).max(axis=2) > 50).sum() > 100


@pytest.mark.slow
def test_a_film_is_written_or_the_encoder_named(drawable, tmp_path):
    path = tmp_path / "gimbal.mp4"
    size = {"seconds": 0.4, "width": 160, "height": 120, "poses": 2}
    if importlib.util.find_spec("imageio_ffmpeg") is None:
        with pytest.raises(
            InputError, match=r"pip install .*imageio-ffmpeg.*; or write \.gif"
        ):
            render_file(path, "gimbal", **size)
    else:
        render_file(path, "gimbal", **size)
        assert path.read_bytes()[4:8] == b"ftyp"


@pytest.mark.parametrize("name", sorted({*scenes()} - {"gimbal"}))
def test_every_scene_has_the_camera(name):
    model = load_model(model_path(name)).model
    assert CAMERA in [model.camera(k).name for k in range(model.ncam)]


@pytest.mark.ci
def test_an_arrow_ends_where_its_letter_is(drawable):
    """MuJoCo draws arrows half as long as they say: seen here if that changes."""
    chosen = load_model(model_path("freefall")).model
    job = {
        "qpos": np.array([[0, 0, 0.4, 1, 0, 0, 0]], float),
        "force": np.array([[0.0, 9.80665, 0.0]]),
        "size": np.array([960, 720]),
    }
    (frame,) = pictures.drawn_frames(chosen, job)
    _, x, _, z, _ = frame.places
    for tip, colour in ((x, 2), (z, 1)):
        near, far = (
            frame.pixels[
                int(at[1]) - 6 : int(at[1]) + 7, int(at[0]) - 6 : int(at[0]) + 7
            ].astype(int)
            for at in (
                tip + 0.06 * (frame.places[0] - tip),
                tip * 1.06 - 0.06 * frame.places[0],
            )
        )
        excess = [part[..., colour] - part[..., 0] for part in (near, far)]
        assert (excess[0] > 60).sum() > 5  # blue or green, just inside
        assert (excess[1] > 60).sum() == 0  # none just beyond
