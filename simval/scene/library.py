"""MuJoCo for its physics, whatever `MUJOCO_GL` says: nothing is drawn in this process.

MuJoCo ends its own import where that variable names a graphics library that is not
there. It is then imported without one. If it is there, the process has it as its user
wants it. Pictures are drawn in a process of their own (`simval.scene.frames`).
"""

from simval.startup import no_renderer

try:
    import mujoco
except Exception:  # whatever a graphics library raises that is half there
    with no_renderer():
        import mujoco

__all__ = ["mujoco"]
