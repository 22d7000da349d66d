"""Workers anywhere in a Ray cluster, each with its own copy of the policy and environments beside it.

What they play was drawn by weights that are an update or more old; the learner corrects that with V-trace,
as IMPALA does (Espeholt et al. 2018, https://arxiv.org/abs/1802.01561). Ray carries weights one way and
arrays of steps the other, through its object stores. It comes with `activelsd[ray]` and is imported where it
is used.
"""
