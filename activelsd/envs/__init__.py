"""The worlds, behind one Gymnasium interface; importing this package registers them with Gymnasium."""

import gymnasium

gymnasium.register(
    "activelsd/ModelNet-v0",
    entry_point="activelsd.envs.modelnet.env:ModelNetEnv",
    vector_entry_point="activelsd.envs.modelnet.env:make_vector",
)
gymnasium.register(
    "activelsd/AVD-v0",
    entry_point="activelsd.envs.avd.env:AVDEnv",
    vector_entry_point="activelsd.envs.avd.env:make_vector",
)
gymnasium.register(
    "activelsd/THOR-v0",
    entry_point="activelsd.envs.thor.env:THOREnv",
    vector_entry_point="activelsd.envs.thor.env:make_vector",
)
