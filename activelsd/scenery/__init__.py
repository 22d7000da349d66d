"""The objects and rooms that worlds show: meshes, embedded shapes, furnished rooms, and their ray caster."""
