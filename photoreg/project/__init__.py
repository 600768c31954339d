"""The project folder and its database."""

from photoreg.project.folder import DATABASE as DATABASE
from photoreg.project.project import Project as Project
from photoreg.project.project import StoredStep as StoredStep
