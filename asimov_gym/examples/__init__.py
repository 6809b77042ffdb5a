"""Examples that a user would write, against `asimov robot` in another terminal; run each with `python -m`."""
