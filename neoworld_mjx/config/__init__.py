"""Configuration: declarations of all options, and their validation and reading from YAML."""

from ..io.limited_worker import FileOptions
from ..io.text_files import parse_yaml, read_yaml
from ..options import Option, Options, list_options, option_values
from .model_options import MLLMOptions, Role, RoleOptions
from .object_options import (
    AlignOptions,
    ComposeOptions,
    JointSweepOptions,
    Language,
    ParseOptions,
    ProgramOptions,
    VerifyOptions,
)
from .run_config import WITHOUT_CRITICS, Config, load_config, merged
from .search_options import (
    CEMOptions,
    RefineOptions,
    RewardOptions,
    RolloutOptions,
    SemanticOptions,
    SettleOptions,
)

__all__ = [
    "WITHOUT_CRITICS",
    "AlignOptions",
    "CEMOptions",
    "ComposeOptions",
    "Config",
    "FileOptions",
    "JointSweepOptions",
    "Language",
    "MLLMOptions",
    "Option",
    "Options",
    "ParseOptions",
    "ProgramOptions",
    "RefineOptions",
    "RewardOptions",
    "Role",
    "RoleOptions",
    "RolloutOptions",
    "SemanticOptions",
    "SettleOptions",
    "VerifyOptions",
    "list_options",
    "load_config",
    "merged",
    "option_values",
    "parse_yaml",
    "read_yaml",
]
