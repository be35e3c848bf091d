"""Bayesian estimation of parameters from residual vectors. Knows nothing of FMI, plants or controllers."""

from .contract import AskTell as AskTell
from .contract import Estimate as Estimate
from .contract import Estimator as Estimator
from .contract import NoEstimateError as NoEstimateError
from .contract import Rescoring as Rescoring
from .contract import Solver as Solver
from .methods import METHODS as METHODS
from .methods import Method as Method
from .objective import LinearForm as LinearForm
from .objective import Objective as Objective
from .paper import PaperBO as PaperBO
from .paper import PaperSettings as PaperSettings
from .space import Parameter as Parameter
from .space import ParameterSpace as ParameterSpace
from .space import Vector as Vector
from .target import TargetSettings as TargetSettings
from .target import TargetVector as TargetVector
from .telemetry import DerivativeResidual as DerivativeResidual
from .telemetry import Model as Model
from .telemetry import ResidualWindow as ResidualWindow
from .telemetry import Sample as Sample
from .telemetry import chi2_limit as chi2_limit
