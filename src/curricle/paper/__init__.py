"""*Curriculum Learning via Reward Shaping*, reproduced: its figures, claims and open questions.

Each figure is one function, written with Curricle's public names only.
"""
