"""pytest plugin (entry point ``pytest11``); heavy imports wait until a fixture is used."""
