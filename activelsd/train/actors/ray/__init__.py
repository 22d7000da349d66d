"""Workers anywhere in a Ray cluster, each with its own copy of the policy and its own environments.

Their weights are an update or more old; the learner corrects for that with V-trace, as IMPALA does (Espeholt
et al. 2018, https://arxiv.org/abs/1802.01561). Ray sends weights to the workers and arrays of steps back,
through its object stores. It is installed by `activelsd[ray]` and imported only when it is used.
"""
