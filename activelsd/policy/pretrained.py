"""Trunks of timm (https://github.com/huggingface/pytorch-image-models), with weights from a file."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from activelsd.errors import ConfigError, did_you_mean, some
from activelsd.policy.frozen import FrozenNet
from activelsd.policy.trunks import ViewTrunk
from activelsd.policy.weights import digest, find_weights, read_weights

_VERSION = "1"
"""Of what is done to pictures before the net sees them; part of the digest of recorded features."""


class TimmTrunk(ViewTrunk):
    """A net of timm sees every view, scaled to the side that it was trained on and normalised as it was.

    Gray is repeated to three channels. Batch normalisation keeps the statistics of its weights, also where
    the net is trained on: the views of a few episodes are too few and too alike to estimate them.
    """

    free = ("weights", "download", "freeze", "rate", "input", "variants")
    net_name: ClassVar[str]
    mean: Tensor
    deviation: Tensor

    def __init__(
        self,
        channels: int,
        size: int,
        *,
        frames: int = 1,
        features: int = 512,
        weights: str | None = None,
        download: bool = False,
        freeze: str | int = "all",
        rate: float = 0.1,
        input: int | None = None,
        variants: int = 4,
    ) -> None:
        """Build the neck, and, unless all of it is frozen, the net.

        Raises:
            ConfigError: timm is not installed or has no such net, or the weights do not fit it.
        """
        timm = _timm()
        if not timm.is_model(self.net_name):
            hint = did_you_mean(self.net_name, timm.list_models())
            raise ConfigError(f"timm has no net '{self.net_name}'; {hint}")
        config = timm.get_pretrained_cfg(self.net_name)
        with torch.device("meta"):
            width = int(timm.create_model(self.net_name, num_classes=0).num_features)
        super().__init__(frames, width, features, frozen=freeze == "all")
        self._file = None if weights is None else find_weights(Path(weights))
        self._download, self._input, self.rate = download, input or int(config.input_size[-1]), rate
        self.variants = variants
        for name, values in (("mean", config.mean), ("deviation", config.std)):
            tensor = torch.tensor(values).view(-1, 1, 1)
            self.register_buffer(name, tensor, persistent=False)
        self._source = "hub:" + str(config.hf_hub_id or config.url) + f":{config.tag}"
        if self.frozen:
            self._frozen_net = FrozenNet(self._build)
        else:
            self.net = self._build()
            self._settle(freeze)
            self.train()

    @classmethod
    def named(cls, name: str) -> type[TimmTrunk]:
        """The trunk's class for a net, by timm's name of it."""
        return type(cls.__name__, (cls,), {"net_name": name, "__module__": cls.__module__})

    def embed(self, pictures: Tensor) -> Tensor:
        """uint8 (N, C, S, S) to float (N, F)."""
        scaled = pictures.float().mul_(1 / 255)
        side = self._input
        if scaled.shape[-1] != side:
            shrinks = scaled.shape[-1] > side
            scaled = functional.interpolate(scaled, (side, side), mode="bilinear", antialias=shrinks)
        normalised = (scaled.expand(-1, 3, -1, -1) - self.mean) / self.deviation
        found: Tensor = self._frozen_net(normalised) if self.frozen else self.net(normalised)
        return found

    def digest(self) -> str:
        """The net, its weights, and what is done to pictures."""
        whose = self._source if self._file is None else digest(self._file)
        return f"timm:{self.net_name} {whose} {self._input} {self.mean.flatten().tolist()} {_VERSION}"

    def train(self, mode: bool = True) -> TimmTrunk:
        """Sets the mode as in PyTorch; normalisation that has statistics stays in evaluation mode."""
        super().train(mode)
        for module in () if self.frozen or not self._pretrained else self.net.modules():
            if isinstance(module, nn.modules.batchnorm._BatchNorm):  # there is no public base
                module.eval()
        return self

    @property
    def _pretrained(self) -> bool:
        return self._file is not None or self._download

    def _build(self) -> nn.Module:
        make: Any = _timm().create_model
        options: dict[str, Any] = {"num_classes": 0, "pretrained": self._download and self._file is None}
        try:
            try:
                net: nn.Module = make(self.net_name, img_size=self._input, **options)
            except TypeError:  # nets that take pictures of any size have no such option
                net = make(self.net_name, **options)
        except (OSError, RuntimeError) as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise ConfigError(
                f"timm cannot make '{self.net_name}' ({reason}); name a file by policy.trunk.weights."
            ) from None
        if self._file is not None:
            net.load_state_dict(_fitted(read_weights(self._file), net, self.net_name, self._file))
        return net

    def _settle(self, freeze: str | int) -> None:
        """Freezes the first stages, counted from the input."""
        if not isinstance(freeze, int):
            return
        net: Any = self.net
        group: Any = importlib.import_module("timm.models").group_parameters
        stages = group(net, net.group_matcher(coarse=True))
        if freeze >= len(stages):
            raise ConfigError(
                f"policy.trunk.freeze={freeze} is all of '{self.net_name}', which has {len(stages)} stages;"
                " write policy.trunk.freeze=all."
            )
        for stage in sorted(stages)[:freeze]:
            for name in stages[stage]:
                self.net.get_parameter(name).requires_grad_(False)


def _timm() -> Any:
    try:
        return importlib.import_module("timm")
    except ImportError:
        raise ConfigError(
            "Trunks of timm need it, and it is not installed; install it with: pip install 'activelsd[timm]'"
        ) from None


def _fitted(state: Mapping[str, Tensor], net: nn.Module, name: str, file: Path) -> dict[str, Tensor]:
    """The tensors of a file under the net's own names, without those of its classifier.

    Raises:
        ConfigError: they are not the net's.
    """
    whole: nn.Module = _timm().create_model(name, pretrained=False)
    wanted, names = net.state_dict(), whole.state_dict()
    if not state.keys() & names.keys() and _same_in_order(state, names):
        # Published under names of its author's: the same tensors in the same order.
        state = dict(zip(names, state.values(), strict=True))
    else:
        change = getattr(sys.modules[type(net).__module__], "checkpoint_filter_fn", None)
        state = dict(state) if change is None else change(dict(state), net)
    classifier: Any = whole.pretrained_cfg["classifier"]  # type: ignore[index]
    heads = (classifier,) if isinstance(classifier, str) else tuple(classifier or ())
    state = {
        key: value
        for key, value in state.items()
        if key in wanted or not any(key.startswith(f"{head}.") for head in heads)
    }
    wrong = [key for key in wanted if key not in state or state[key].shape != wanted[key].shape]
    wrong += [key for key in state if key not in wanted]
    if wrong:
        raise ConfigError(
            f"{file} does not hold the weights of '{name}' ({some(wrong, 1)}); name the file of that net."
        )
    return state


def _same_in_order(state: Mapping[str, Tensor], other: Mapping[str, Tensor]) -> bool:
    return [x.shape for x in state.values()] == [x.shape for x in other.values()]
