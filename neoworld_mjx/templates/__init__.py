"""Templates: object programs with parameter ranges, one for each category of everyday objects."""

from .template import Parameter, Template, read_template, template, templates

__all__ = ["Parameter", "Template", "read_template", "template", "templates"]
