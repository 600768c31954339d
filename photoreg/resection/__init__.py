"""A camera from clicked pairs of points in photo and mesh."""

from photoreg.resection.solver import CLICK_SIGMA_PX as CLICK_SIGMA_PX
from photoreg.resection.solver import FOCAL_SIGMA as FOCAL_SIGMA
from photoreg.resection.solver import GUESSED_FOCAL_SIDES as GUESSED_FOCAL_SIDES
from photoreg.resection.solver import GUESSED_FOCAL_SIGMA as GUESSED_FOCAL_SIGMA
from photoreg.resection.solver import N_FOCAL as N_FOCAL
from photoreg.resection.solver import N_POSE as N_POSE
from photoreg.resection.solver import N_PRINCIPAL as N_PRINCIPAL
from photoreg.resection.solver import PRINCIPAL_SIGMA_SIDES as PRINCIPAL_SIGMA_SIDES
from photoreg.resection.solver import Resection as Resection
from photoreg.resection.solver import Solved as Solved
from photoreg.resection.solver import solve_camera as solve_camera
