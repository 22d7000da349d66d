"""Actors play and give rollouts; `resident` plays recorded views on the learner's own device."""
