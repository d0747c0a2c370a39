"""*Curriculum Learning via Reward Shaping*, reproduced: its figures, claims and open questions.

Each figure has its own module, written with Curricle's public names only.
"""
