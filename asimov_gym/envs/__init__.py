"""How learners see the robot: Gymnasium environments, single and vectorised, over batches of simulated robots.

`import asimov_gym` registers `Asimov-Walk-v0`, `Asimov-Trajectory-v0` and `Asimov-Velocity-v0`.
"""
