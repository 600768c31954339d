"""All settings of a refinement, and the presets."""

import dataclasses
from typing import Annotated, Literal

import numpy as np
import tyro

from photoreg.errors import InputError
from photoreg.geometry.lens import N_TERMS, Distortion
from photoreg.geometry.mesh import VisibilityMethod
from photoreg.parameters.bounds import PriorScales
from photoreg.parameters.gene_box import CameraModel, Coordinates, GeneBox
from photoreg.polish.config import PolishConfig
from photoreg.search.config import ConsistencyConfig
from photoreg.search.genetic import GeneticConfig

PresetName = Literal["default", "paper", "fast", "thorough"]

LARGEST_SEED = 2**63 - 1
"""A project's database and the page's messages hold integers of 64 bits."""

MOST_SAMPLES = 10_000_000
"""Each takes some hundred bytes."""

OBJECT_BOX = GeneBox(
    focal=0.04, principal_point=0.01, rotation_deg=4.5, scale=0.08, shift=0.05
)
"""Holds starts up to about 40 px off at 1,024 px width, whatever combination of focal
length, principal point, turn and place is wrong."""

REDUCED_PHOTOS = ConsistencyConfig(max_side_px=512, blur_px=1.5)
"""Photos reduced and blurred: the search only has to find the basin of the polish."""

SHORT_SEARCH = GeneticConfig(
    population=300,
    generations=100,
    restarts=1,
    selection="tournament",
    tournament_size=4,
    mutations="each_gene",
    mutation_sigma_end=0.05,
)

POLISH = PolishConfig()


@dataclasses.dataclass(frozen=True, kw_only=True)
class RegistrationConfig:
    """All settings of a refinement."""

    seed: int = 0
    """Same seed, same answer, whatever the number of threads; 0 to 2^63 - 1."""
    samples: int = 1000
    """Surface points that the search compares, 10 to ten million."""
    focus_samples: bool = True
    """Take the surface points only where two photos may see them; false: from the
    whole surface, as the paper does."""
    camera_model: CameraModel = "pinhole"
    """pinhole: square pixels, no skew, 9 genes a camera. full: 11."""
    coordinates: Coordinates = "object"
    """Genes of the cameras: camera (the paper's) or object (turns about the object)."""
    box: GeneBox = OBJECT_BOX
    """Gene intervals around the start."""
    tie_focal_to_distance: bool = True
    """First population by the paper's eq. 4, f / d ~ w / W."""
    occlusion: VisibilityMethod = "rays"
    """How points hidden behind the surface are found, at the start and after each
    restart: rays, depth, or normals (not at all, as in the paper)."""
    consistency: ConsistencyConfig = REDUCED_PHOTOS
    """How photos are compared in the search."""
    genetic: Annotated[GeneticConfig, tyro.conf.arg(name="")] = SHORT_SEARCH
    """The search."""
    pull: float = 1.0
    """Pull towards the start, 0 or more: the search's cost is multiplied by 1 + pull
    times the mean square of the genes (1: the ends of the box). Photos agree nearly as
    well when both cameras slide together over the surface; this keeps them where they
    were put. 0: none, as in the paper."""
    foreground: float = 1.0
    """Weight in the search, 0 or more, of whether the object lies where each photo has
    the object's colours, relative to the colours' disagreement at the start. Without
    it cameras slide onto a background that looks the same everywhere. 0: none, as in
    the paper."""
    polish_after: bool = True
    """Whether the polish follows the search."""
    polish: PolishConfig = POLISH
    """The polish."""
    principal_point_prior: float = dataclasses.field(default=1.0, repr=False)
    """How much farther than its interval of the box the polish lets a principal point
    go, above 0 and at most 50. 1: no farther, as with every other interval."""

    distortion: Distortion = dataclasses.field(default="auto", repr=False)
    """How much of each lens the polish solves: none (all stays as given), auto (k1, the
    first radial term, and all five where the photos decide them), k1, k1k2, or full (k1,
    k2, p1, p2, k3)."""

    def __post_init__(self) -> None:
        if self.distortion not in N_TERMS:
            raise InputError(
                f"distortion is {self.distortion!r}; choose {', '.join(N_TERMS)}."
            )
        if not 0 <= self.seed <= LARGEST_SEED:
            raise InputError(f"seed is {self.seed:g}; give 0 to {LARGEST_SEED:,}.")
        if not 10 <= self.samples <= MOST_SAMPLES:
            raise InputError(
                f"samples is {self.samples:g}; give 10 to {MOST_SAMPLES:,}."
            )
        if not 0.0 <= self.pull < np.inf:
            raise InputError(f"pull is {self.pull}; give 0 or more.")
        if not 0.0 <= self.foreground < np.inf:
            raise InputError(f"foreground is {self.foreground}; give 0 or more.")
        if not 0.0 < self.principal_point_prior <= 50.0:
            raise InputError(
                f"principal_point_prior is {self.principal_point_prior}; give a number "
                "above 0, at most 50."
            )

    @property
    def prior_scales(self) -> PriorScales:
        """One sigma of the polish's prior: the paper's intervals, for the usual box.

        Where an interval of the box is wider or narrower than usual, so is its own of
        the prior; the place follows the wider of shift and size.
        """
        box, paper = self.box, PriorScales()
        usual = OBJECT_BOX if self.coordinates == "object" else GeneBox()
        if self.coordinates == "object":
            place = max(box.shift / usual.shift, box.scale / usual.scale)
        else:
            place = box.translation / usual.translation
        lens = self.principal_point_prior * box.principal_point / usual.principal_point
        return PriorScales(
            rotation_deg=paper.rotation_deg * (box.rotation_deg / usual.rotation_deg),
            translation=paper.translation * place,
            focal=paper.focal * (box.focal / usual.focal),
            principal_point=paper.principal_point * lens,
        )

    def searching_wider(self) -> "RegistrationConfig":
        """These settings with the search of the preset ``thorough``, and the next seed."""
        thorough = RegistrationConfig.preset("thorough")
        return dataclasses.replace(
            self,
            seed=(self.seed + 1) % LARGEST_SEED,
            box=thorough.box,
            consistency=thorough.consistency,
            pull=thorough.pull,
            principal_point_prior=thorough.principal_point_prior,
            genetic=thorough.genetic,
        )

    @classmethod
    def preset(
        cls, name: PresetName = "default", seed: int = 0
    ) -> "RegistrationConfig":
        """The settings of a preset.

        ``default``: a short search that finds the basin, then the polish. ``fast``: a
        shorter search. ``thorough``: a wider box and a longer search. ``paper``: the
        genetic algorithm exactly as the paper has it, alone.

        Raises:
            InputError: if there is no such preset.
        """
        default = cls(seed=seed)
        if name == "default":
            return default
        if name == "fast":
            return dataclasses.replace(
                default,
                genetic=dataclasses.replace(
                    default.genetic, population=150, generations=40
                ),
            )
        if name == "thorough":
            return dataclasses.replace(
                default,
                # Starts 80 px off are turned about the object by up to 25 degrees.
                box=default.box.widened(2.7),
                # In so wide a box cameras can slide until a fifth of the points lies
                # on the background, and trimming a fifth would forgive it: of five
                # starts 80 px off, one ended at 220 px by the alpha-trimmed mean,
                # none over 46 px like this.
                consistency=dataclasses.replace(
                    default.consistency, cost="trimmed_squares", alpha=0.1, blur_px=2.0
                ),
                pull=2.0,
                # In a cropped photo the principal point is far off the middle. A rock
                # cropped by a quarter ended 0.70 px off like this, 4.1 px off with 1;
                # another one, uncropped, at 0.028 and 0.033 px.
                principal_point_prior=2.7,
                genetic=dataclasses.replace(
                    default.genetic,
                    population=1500,
                    generations=200,
                    tournament_size=3,
                ),
            )
        if name == "paper":
            return cls(
                seed=seed,
                samples=1000,
                focus_samples=False,
                coordinates="camera",
                box=GeneBox(),
                occlusion="normals",
                consistency=ConsistencyConfig(
                    exposure=False, min_share=0.0, max_side_px=1 << 30
                ),
                genetic=GeneticConfig(),
                pull=0.0,
                foreground=0.0,
                polish_after=False,
            )
        raise InputError(
            f"{name!r} is not a preset; choose default, paper, fast or thorough."
        )
