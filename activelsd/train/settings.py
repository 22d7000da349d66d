"""The settings of training, with what each one means."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, model_validator

from activelsd.errors import ConfigError

if TYPE_CHECKING:  # settings are read and checked before PyTorch is imported
    from torch import Tensor


class Anneal(BaseModel):
    """A value that moves linearly from start to end over the first `train.anneal` of the steps."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    start: float = Field(ge=0, description="value at the first step")
    end: float = Field(ge=0, description="value from then on")

    def at(self, progress: float) -> float:
        """The value at a progress of 0..1."""
        return self.start + (self.end - self.start) * min(max(progress, 0.0), 1.0)


class EpsilonAnneal(Anneal):
    """An `Anneal` of a probability."""

    start: float = Field(ge=0, le=1, description="probability at the first step")
    end: float = Field(ge=0, le=1, description="probability from then on")


class Annealed(NamedTuple):
    """Current values of all annealed settings, as floats or scalar tensors."""

    epsilon_branch: float | Tensor
    epsilon_leaf: float | Tensor
    entropy_branch: float | Tensor
    entropy_leaf: float | Tensor
    learning_rate: float | Tensor


class GA3CSettings(BaseModel):
    """Agents, queues, predictors and trainers of `train.actors=ga3c`."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    kind: Literal["processes", "threads"] = Field(
        "processes", description="where environments run; threads: recorded views only"
    )
    agents: int = Field(16, ge=1, description="processes or threads that step environments")
    envs_per_agent: int = Field(
        1, ge=1, description="environments an agent steps in turn; more where a step takes no time"
    )
    lanes: int = Field(
        1,
        ge=1,
        le=8,
        description="groups of an agent's environments: one is stepped while the others wait for answers",
    )
    starting: int = Field(4, ge=1, description="agents that start at the same time")
    start_timeout_s: float = Field(300.0, gt=0, description="seconds that a process may take to start")
    timeout_s: float = Field(60.0, gt=0, description="seconds that a step may take before it is replaced")
    restarts: int = Field(10, ge=0, description="how often an agent is replaced before training gives up")

    predictors: int = Field(1, ge=1, description="threads that answer what waits in the prediction queue")
    prediction_batch: int = Field(128, ge=1, description="most observations answered at once")
    prediction_wait_ms: float = Field(
        0.0, ge=0, description="how long an agent may wait for others to ask too; 0: answer what waits"
    )
    trainers: int = Field(1, ge=1, description="threads that batch what waits in the training queue")
    training_batch: int | None = Field(
        None, ge=1, description="trajectories of an update; null: as many as environments"
    )

    dynamic: bool = Field(
        False, description="search for the fastest numbers of agents, predictors and trainers"
    )
    dynamic_every_s: float = Field(60.0, gt=0, description="seconds that each setting is measured")

    @model_validator(mode="after")
    def _lanes_are_alike(self) -> GA3CSettings:
        if self.envs_per_agent % self.lanes:
            raise ValueError(
                f"train.ga3c.envs_per_agent={self.envs_per_agent} is no multiple of"
                f" train.ga3c.lanes={self.lanes}; choose one that is"
            )
        return self


class RaySettings(BaseModel):
    """Workers of `train.actors=ray`: agents with the policy and recorded views beside them, in a cluster."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    address: str | None = Field(
        None, description="cluster to join, as host:port or auto; null: one is started here for the run"
    )
    workers: int = Field(4, ge=1, description="agents in all; each takes a CPU wherever there is one")
    envs_per_worker: int = Field(16, ge=1, description="episodes that an agent plays side by side")
    training_batch: int | None = Field(
        None, ge=1, description="rollouts of an update, the first to arrive; null: as many as workers"
    )
    start_timeout_s: float = Field(
        600.0, gt=0, description="seconds that a worker may take to find room, and then to open its worlds"
    )
    timeout_s: float = Field(60.0, gt=0, description="seconds that a rollout may take, weights included")
    restarts: int = Field(10, ge=0, description="how often a worker is replaced before training gives up")


class TrainSettings(BaseModel):
    """How long, how fast and by which loss."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    steps: int = Field(1_000_000, ge=1, description="environment steps in all")
    actors: Literal["resident", "ga3c", "ray"] = Field(
        "resident",
        description="who plays: the learner itself, GA3C agents with batched prediction, or a Ray cluster",
    )
    envs: int = Field(64, ge=1, description="resident: episodes played side by side")
    ga3c: GA3CSettings = Field(GA3CSettings(), description="agents with batched prediction")
    ray: RaySettings = Field(RaySettings(), description="agents in a Ray cluster; recorded views only")
    vary_crops: bool = Field(
        True, description="augment crops of targets: random margin and brightness per episode"
    )
    mirror: bool = Field(False, description="mirror every other episode; every move needs its opposite")
    dropout: float = Field(
        0.0, ge=0, lt=1, description="dropout probability of the memory's features, drawn at every view"
    )
    amp: bool = Field(False, description="resident: run the network in bfloat16, for processors made for it")
    compile: bool = Field(False, description="resident: compile the network with torch.compile")
    cuda_graphs: bool | None = Field(
        None,
        description="resident, on a GPU: make each update, acting and learning, one CUDA graph; null: yes,"
        " if one process learns",
    )
    length: int = Field(5, ge=1, description="steps of a rollout, the n of n-step returns")

    trajectories: int | None = Field(
        None,
        ge=1,
        description="resident: episodes whose steps an update learns from, one update after the other, as in"
        " GA3C; null: all that are played side by side",
    )

    gamma: float = Field(0.98, ge=0, le=1, description="discount per action")
    reward_clip: float | None = Field(None, gt=0, description="clip rewards to plus or minus this")
    bootstrap_at_limit: bool = Field(
        False, description="bootstrap from the value if an episode is cut at max_views"
    )
    vtrace: bool | None = Field(
        None,
        description="correct returns for policy lag by V-trace; null: with ray only, whose lag is longer",
    )
    value_weight: float = Field(0.5, ge=0, description="weight of the value loss")
    terms: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(
        {"supervised": 1.0}, description="weight of each loss term by name; 0: none"
    )
    rewarded_classes: bool = Field(
        True, description="rewards also teach which class to name; false: the loss terms alone do"
    )
    entropy_branch: Anneal = Field(Anneal(start=0.05, end=0.005), description="entropy bonus: answer or move")
    entropy_leaf: Anneal = Field(
        Anneal(start=0.01, end=0.01), description="entropy bonus: which answer or move"
    )
    epsilon_branch: EpsilonAnneal = Field(EpsilonAnneal(start=0.8, end=0.02), description="random branch")
    epsilon_leaf: EpsilonAnneal = Field(EpsilonAnneal(start=0.3, end=0.02), description="random leaf")
    anneal: float = Field(0.6, gt=0, le=1, description="share of the steps over which these are annealed")

    loss: Literal["mean", "sum"] = Field(
        "mean", description="losses are averaged over the steps of an update, or summed, as in GA3C"
    )
    optimiser: Literal["adam", "rmsprop", "tf_rmsprop"] = Field(
        "adam", description="which optimiser; tf_rmsprop: TensorFlow 1's form, as in GA3C"
    )
    optimiser_epsilon: float = Field(1e-5, gt=0, description="the optimiser's guard against division by zero")
    learning_rate: float = Field(2e-3, gt=0, description="step size at the start")
    decay: bool = Field(True, description="let the step size fall linearly to zero")
    clip_norm: float | None = Field(1.0, gt=0, description="clip the gradient's norm to this")

    log_every: int = Field(10_000, ge=1, description="steps between two rows of metrics")
    evaluate_every: int = Field(
        150_000, ge=1, description="steps between two evaluations on the validation split"
    )
    checkpoint_every: int = Field(50_000, ge=1, description="steps between two checkpoints")
    loggers: list[str] = Field(["tensorboard"], description="where metrics go beside metrics.jsonl")

    @model_validator(mode="after")
    def _classes_are_taught(self) -> TrainSettings:
        teachers = {name for name, weight in self.terms.items() if weight} - {"guided", "smoothing"}
        if not self.rewarded_classes and not teachers:
            raise ConfigError(
                "train.rewarded_classes=false leaves nobody to teach the classes; leave it true, or set"
                " train.terms.supervised=1."
            )
        return self

    def at(self, progress: float) -> Annealed:
        """The annealed values when this share of the training is done, 0..1."""
        annealed = progress / self.anneal
        return Annealed(
            self.epsilon_branch.at(annealed),
            self.epsilon_leaf.at(annealed),
            self.entropy_branch.at(annealed),
            self.entropy_leaf.at(annealed),
            self.learning_rate * (1.0 - progress if self.decay else 1.0),
        )

    @property
    def corrects_lag(self) -> bool:
        """Whether V-trace is on."""
        return self.actors == "ray" if self.vtrace is None else self.vtrace
