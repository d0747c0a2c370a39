from .arms import compare as compare
from .attribution import Attribution as Attribution, Region as Region, attribute as attribute
from .choice_flips import flips as flips
from .comparison import Arm as Arm, Comparison as Comparison, Contrast as Contrast
from .forecasting import Forecast as Forecast, ForecastRow as ForecastRow, forecast as forecast
from .task_differences import differences as differences
