"""Run by `torchrun`: every process learns from its part of one rollout, and the first saves the weights."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from activelsd.policy.checkpoint import save_network
from activelsd.train.learner import Learner
from activelsd.train.parallel import Group, leave
from activelsd.train.settings import TrainSettings
from tests.train.test_parallel import UPDATES, some_rollout

group = Group.joined("cpu")
network, rollout = some_rollout()
learner = Learner(network, TrainSettings(**json.loads(sys.argv[2])), group)
half = rollout.first.shape[1] // group.size
mine = rollout.columns(slice(group.rank * half, (group.rank + 1) * half))
for progress in UPDATES:
    learner.update(mine, learner.settings.at(progress))
if group.rank == 0:
    save_network(network, Path(sys.argv[1]))
leave(0)
