"""The nouns: small frozen dataclasses on numpy and cv2 only, no input or output."""
