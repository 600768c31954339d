"""The whole refinement: settings, events, checkpoint, verdict."""

from photoreg.parameters.freedom import Freedom as Freedom
from photoreg.registration.checkpoint import Checkpoint as Checkpoint
from photoreg.registration.config import PresetName as PresetName
from photoreg.registration.config import RegistrationConfig as RegistrationConfig
from photoreg.registration.events import Event as Event
from photoreg.registration.events import Finished as Finished
from photoreg.registration.events import Progress as Progress
from photoreg.registration.refinement import refine as refine
