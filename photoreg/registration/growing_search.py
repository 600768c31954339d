"""The search among many photos: two of them first, then one after the other.

An individual of all cameras at once would have nine genes per photo, and its search would
take many more generations. Each photo shares most of its surface with few others, so it
is searched for alone, against those of them that are already found and held.
"""

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from photoreg.errors import RefinementError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.imaging.photo import Pair, Photo
from photoreg.parameters.freedom import Freedom, Held
from photoreg.registration.config import RegistrationConfig
from photoreg.registration.genetic_search import GeneticSearch
from photoreg.search.genetic import Generation, GeneticConfig

MOST_HELD = 3
"""Photos that one is searched for against, at most: the best of those it is compared
with."""
SEED_SIZE = 2
"""Photos that are searched for at once where none is found yet."""
HELD = Held(focal=True, principal_point=True, pose=True, lens=True)


@dataclasses.dataclass(frozen=True)
class Stage:
    """What is searched for at a time."""

    searched: tuple[int, ...]
    """Photos, by index."""
    against: tuple[int, ...]
    """Photos that are found already, or held."""


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class GrowingStep:
    """The search after one generation."""

    stage: int
    n_stages: int
    generation: int
    """Of this stage; 0 is the first population."""
    n_generations: int
    """Of each stage, at most."""
    newest: Generation
    """Its costs are comparable within this stage only."""
    evaluations: int
    """Over all stages so far."""
    cameras: tuple[Camera, ...]
    """Of all photos: found so far, or as they came."""

    @property
    def fraction(self) -> float:
        """Share of the generations of all stages that are done."""
        return (self.stage + self.generation / self.n_generations) / self.n_stages


class GrowingSearch:
    """A search around rough cameras of many photos, ready to run."""

    def __init__(
        self,
        mesh: Mesh,
        photos: Sequence[Photo],
        start: Sequence[Camera],
        config: RegistrationConfig,
        freedom: Freedom,
        pairs: Sequence[Pair],
        scores: Float[np.ndarray, "n n"],
    ) -> None:
        """``pairs`` says which photos are compared, ``scores`` how informative that is."""
        self._mesh, self._photos, self._start = mesh, photos, tuple(start)
        self._config, self._freedom = config, freedom
        held = [i for i in range(len(photos)) if freedom.of(i).everything]
        self.stages = stages_of(pairs, scores, held)

    def steps(self) -> Iterator[GrowingStep]:
        """Runs the search, stage by stage."""
        cameras, evaluations = list(self._start), 0
        for number, stage in enumerate(self.stages):
            group = (*stage.searched, *stage.against)
            freedom = self._freedom_of(stage)
            if all(freedom.of(k).everything for k in range(len(stage.searched))):
                # Nothing is left but a focal length that is shared.
                continue
            config = dataclasses.replace(
                self._config, genetic=stage_settings(self._config.genetic, stage)
            )
            try:
                search = GeneticSearch(
                    self._mesh,
                    [self._photos[i] for i in group],
                    [cameras[i] for i in group],
                    config,
                    freedom,
                )
            except RefinementError:
                # They share too little after all; the polish begins at the start.
                continue
            genetic, last = config.genetic, None
            for last in search.generations():
                for i, camera in zip(group, search.cameras(last), strict=True):
                    if i in stage.searched:
                        cameras[i] = camera
                yield GrowingStep(
                    stage=number,
                    n_stages=len(self.stages),
                    generation=last.restart * genetic.generations + last.generation,
                    n_generations=genetic.generations * genetic.restarts,
                    newest=last,
                    evaluations=evaluations + last.evaluations,
                    cameras=tuple(cameras),
                )
            if last is not None:
                evaluations += last.evaluations

    def _freedom_of(self, stage: Stage) -> Freedom:
        """What is found is held, and so is a focal length that others share."""
        searched = []
        for i in stage.searched:
            own = self._freedom.of(i)
            is_shared = len(self._freedom.group(i)) > 1
            searched.append(dataclasses.replace(own, focal=own.focal or is_shared))
        return Freedom(
            (*searched, *[HELD] * len(stage.against)),
            cropped=tuple(
                k for k, i in enumerate(stage.searched) if self._freedom.is_cropped(i)
            ),
        )


def stages_of(
    pairs: Sequence[Pair], scores: Float[np.ndarray, "n n"], held: Sequence[int] = ()
) -> tuple[Stage, ...]:
    """In which order photos are searched for.

    Starting from the held photos, or else from the two that say most about each other, always
    the photo about which those already found say most. Where no pair leads on, two others
    start anew. A photo without pairs is left out.
    """
    n = len(scores)
    told = np.zeros((n, n))
    for i, k in pairs:
        told[i, k] = told[k, i] = scores[i, k]
    found, waiting = list(held), [i for i in range(n) if i not in held]
    stages = []
    while waiting:
        by_found = told[np.ix_(waiting, found)].sum(axis=1)
        if by_found.max(initial=0.0) > 0.0:
            photo = waiting[int(np.argmax(by_found))]
            order = sorted(found, key=lambda k: -told[photo, k])
            against = tuple(k for k in order if told[photo, k] > 0.0)[:MOST_HELD]
            searched = (photo,)
        else:
            among = told[np.ix_(waiting, waiting)]
            if not among.any():
                break
            first, second = np.unravel_index(int(np.argmax(among)), among.shape)
            searched, against = (waiting[first], waiting[second]), ()
        stages.append(Stage(searched, against))
        found += searched
        waiting = [i for i in waiting if i not in searched]
    return tuple(stages)


def stage_settings(genetic: GeneticConfig, stage: Stage) -> GeneticConfig:
    """Half as many individuals and generations for half as many genes."""
    if len(stage.searched) == SEED_SIZE:
        return genetic
    return dataclasses.replace(
        genetic,
        population=max(4, genetic.population // 2),
        generations=max(1, genetic.generations // 2),
    )
