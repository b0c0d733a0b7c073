"""Many files on many processes or machines: units of work, a store of what they gave, and one table in the end."""
