"""The genetic search of a refinement: what it compares, its cost, its generations."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from photoreg.errors import InputError, RefinementError
from photoreg.geometry.camera import Camera
from photoreg.geometry.mesh import Mesh
from photoreg.geometry.sampling import SurfaceSamples, sample_surface
from photoreg.geometry.visibility import middle_for, samples_for, visible
from photoreg.imaging.photo import Photo
from photoreg.imaging.undistort import undistorted_photo
from photoreg.parameters.freedom import Freedom
from photoreg.parameters.genes import GeneMap
from photoreg.registration.checkpoint import Checkpoint
from photoreg.registration.config import RegistrationConfig
from photoreg.search.foreground import Foreground
from photoreg.search.genetic import Generation, evolve
from photoreg.search.mutual_information import MutualInformation
from photoreg.search.photo_consistency import PhotoConsistency, patches_of


class GeneticSearch:
    """A search around rough cameras, ready to run.

    It knows no lenses: it sees the photos undistorted, as the start's lenses have it, by
    cameras without, and its answers have the start's lenses again.
    """

    def __init__(
        self,
        mesh: Mesh,
        photos: Sequence[Photo],
        start: Sequence[Camera],
        config: RegistrationConfig,
        freedom: Freedom,
    ) -> None:
        """Draws the samples and looks for what is hidden from ``start``.

        One photo is compared with the surface, more with each other.

        Raises:
            RefinementError: if no two of several photos see a common part of the surface.
        """
        self._lenses = [camera.lens for camera in start]
        photos = [
            undistorted_photo(photo, camera)
            for photo, camera in zip(photos, start, strict=True)
        ]
        start = [camera.pinhole for camera in start]
        self._mesh, self._photos, self._config = mesh, photos, config
        self._start = start
        self.agreement: PhotoConsistency | MutualInformation
        """What photos are compared by."""
        if len(photos) == 1:
            self.agreement = MutualInformation(mesh, photos[0], start[0], config.seed)
        else:
            samples = shared_samples(mesh, start, config)
            patches = None
            if config.consistency.cost == "mncc":
                patches = patches_of(mesh, samples, start, config.consistency)
            self.agreement = PhotoConsistency(
                samples, photos, config.consistency, patches=patches
            )
        self.gene_map = search_genes(mesh, start, config, freedom)
        self.hidden_from: np.ndarray | None = None
        """Genes from whose cameras hidden points were last looked for; None: the start."""
        self._resumed: Generation | None = None
        self._hide(start)
        if isinstance(self.agreement, PhotoConsistency):
            self.agreement.require(start)

    def go_on_from(self, checkpoint: Checkpoint) -> tuple[Camera, ...]:
        """Makes ``generations`` resume from there; returns the best cameras until then.

        Raises:
            InputError: if the checkpoint is of another search.
        """
        last, settings = checkpoint.search, self._config.genetic
        wanted = (settings.population, self.gene_map.n_genes)
        if last.genes.shape != wanted or last.restart >= settings.restarts:
            raise InputError(
                f"The kept search should have {wanted[0]} individuals of {wanted[1]} "
                f"genes, but has {last.genes.shape[0]} of {last.genes.shape[1]}; start "
                "the refinement anew."
            )
        self.hidden_from = checkpoint.hidden_from
        if self.hidden_from is not None:
            self._hide(self.gene_map.to_cameras(self.hidden_from))
        self._renew_hidden(last)
        self._resumed = last
        return self.cameras(last)

    def cameras(self, generation: Generation) -> tuple[Camera, ...]:
        """The best cameras of a generation."""
        found = self.gene_map.to_cameras(generation.best_genes)
        return tuple(
            camera.with_lens(lens)
            for camera, lens in zip(found, self._lenses, strict=True)
        )

    def generations(self) -> Iterator[Generation]:
        """Runs the search."""
        config = self._config
        for generation in evolve(
            self._cost(),
            lambda n, rng: self.gene_map.first_population(
                n, rng, config.tie_focal_to_distance
            ),
            config.genetic,
            config.seed,
            start=np.zeros(self.gene_map.n_genes),
            resume=self._resumed,
        ):
            yield generation
            self._renew_hidden(generation)

    def _cost(self) -> Callable[[np.ndarray], np.ndarray]:
        """Cost of genes: colours that differ, object off its colours, far from start."""
        agreement, gene_map = self.agreement, self.gene_map
        pull, share = self._config.pull, self._config.foreground
        if share == 0.0:
            return lambda genes: (
                agreement.costs(genes, gene_map)
                * (1.0 + pull * np.mean(genes**2, axis=1))
            )
        foreground = Foreground(
            self._mesh, self._photos, self._start, self._config.seed
        )
        # In units of the colours' cost: as the start has it, all of it disagreement.
        unit = share * agreement.cost(self._start)
        return lambda genes: (
            (
                agreement.costs(genes, gene_map)
                + unit * foreground.misfits(genes, gene_map)
            )
            * (1.0 + pull * np.mean(genes**2, axis=1))
        )

    def _hide(self, cameras: Sequence[Camera]) -> None:
        """Takes away the votes of what cannot be seen from ``cameras``."""
        method, agreement = self._config.occlusion, self.agreement
        if method != "normals" and isinstance(agreement, PhotoConsistency):
            # Which way a point faces is tested for each individual: not here.
            agreement.allow(
                visible(
                    agreement.samples,
                    cameras,
                    self._mesh,
                    method,
                    min_cosine=0.0,
                )
            )

    def _renew_hidden(self, last: Generation) -> None:
        """Looks anew for hidden points where one restart ends and another follows."""
        if last.stop is not None and last.restart + 1 < self._config.genetic.restarts:
            self.hidden_from = last.best_genes
            self._hide(self.gene_map.to_cameras(last.best_genes))


def shared_samples(
    mesh: Mesh, cameras: Sequence[Camera], config: RegistrationConfig
) -> SurfaceSamples:
    """The points to compare; only where two photos may see them, if so configured.

    Raises:
        RefinementError: if two photos share fewer than 10 points.
    """
    if not config.focus_samples:
        return sample_surface(mesh, config.samples, config.seed)
    # Ten times as many as wanted are enough where a tenth of the surface is shared.
    candidates = samples_for(mesh, cameras, 10 * config.samples, config.seed)
    seen = visible(candidates, cameras, mesh, "rays", config.consistency.min_cosine)
    shared = np.flatnonzero(seen.sum(axis=0) >= 2)
    if len(shared) < 10:
        raise RefinementError(
            "The photos show hardly any common part of the surface with these cameras, "
            f"so they cannot be compared ({len(shared)} of {len(candidates)} points). "
            "Align the cameras, or take photos from nearer viewpoints."
        )
    if len(shared) > config.samples:
        rng = np.random.default_rng(config.seed)
        shared = np.sort(rng.choice(shared, config.samples, replace=False))
    return candidates.subset(shared)


def search_genes(
    mesh: Mesh, start: Sequence[Camera], config: RegistrationConfig, freedom: Freedom
) -> GeneMap:
    """The genes of a search around ``start``, lenses apart."""
    return GeneMap(
        [camera.pinhole for camera in start],
        middle_for(mesh, start),
        config.box,
        config.camera_model,
        config.coordinates,
        freedom,
    )
