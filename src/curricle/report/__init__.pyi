from .page import study_page as study_page
from .study_report import write_report as write_report
from .templates import render as render
