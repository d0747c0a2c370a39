"""*Curriculum Learning via Reward Shaping*, reproduced: its figures, claims and open questions.

Each figure has a file of its own, written with Curricle's public names only.
"""
