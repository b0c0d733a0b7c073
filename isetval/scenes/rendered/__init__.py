"""3-D scenes rendered by Mitsuba 3: scene files, passes with their noise, the sensor behind a lens."""
