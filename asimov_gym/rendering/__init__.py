"""Drawing: which OpenGL works here (`backends`), pictures (`offscreen`), live cameras in a process of their own
(`camera_process`).

Nothing is imported here: `MUJOCO_GL` has to be set before MuJoCo is imported, and `backends` is what finds its value.
"""
