from .design_report import write_design_report as write_design_report
from .study_report import write_report as write_report
from .templates import render as render
