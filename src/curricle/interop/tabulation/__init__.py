"""Tables of Gymnasium environments: every state that can be reached, breadth first."""
