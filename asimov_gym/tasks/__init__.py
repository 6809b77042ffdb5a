"""What is asked of the robot: tasks as pure functions over the array-API standard, batched over the first axis."""
