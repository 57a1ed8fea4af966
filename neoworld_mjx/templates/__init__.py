"""Templates: object programs with parameter ranges, one for each category of everyday objects."""

from .template import Template, read_template, template, templates

__all__ = ["Template", "read_template", "template", "templates"]
