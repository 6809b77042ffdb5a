"""The trainer: `python -m train ppo | export`. Needs the extra `train`."""
