"""The client's end of each lane: what a session stands on. Nothing here is part of the robot."""
