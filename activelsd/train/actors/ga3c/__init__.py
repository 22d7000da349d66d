"""GA3C: many agents, one network, batched prediction and batched training.

Babaeizadeh et al. 2016, https://arxiv.org/abs/1611.06256. Agents step environments, in processes or threads,
and ask for actions in a prediction queue; predictors answer all waiting requests in one pass of the network;
trajectories go through a training queue to trainers, which batch them for the learner. An agent's process
imports no module here that needs PyTorch, so it starts fast.
"""
