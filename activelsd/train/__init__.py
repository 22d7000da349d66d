"""Training: actors that play, a learner that learns from what they played, and the loop around them."""
