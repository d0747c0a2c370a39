from .design_file import DesignPlan as DesignPlan, read_design as read_design
from .from_recipe import study_text as study_text
from .recipe_file import (
    StoredRecipe as StoredRecipe,
    read_recipe as read_recipe,
    recipe_text as recipe_text,
)
