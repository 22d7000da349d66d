"""What worlds are made of: meshes, embedded shapes, furnished rooms, and the ray caster that renders them."""
