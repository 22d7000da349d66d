"""GA3C: many agents, one network, batched prediction and batched training.

Babaeizadeh et al. 2016, https://arxiv.org/abs/1611.06256. Agents step environments, in processes or threads,
and ask for actions in a prediction queue; predictors answer whatever waits there in one pass of the network;
what was played goes through a training queue, as trajectories, to trainers that batch them for the learner.
Nothing here but `predictor`, `trajectory` and `actors` imports PyTorch, so an agent's process starts fast.
"""
