"""Orchard: catch eight ripe apples in the basket; four on the ground lose. Wasps that are caught cost a life too."""

import gymnasium as gym
import numpy as np
import pygame

W = H = 84
GROUND = 74
NEEDED = 8
MISTAKES = 4


class Orchard(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    def __init__(self, render_mode=None):
        self.render_mode = render_mode
        self.observation_space = gym.spaces.Box(0, 255, (H, W, 3), np.uint8)
        self.action_space = gym.spaces.MultiDiscrete([5, 2, 2])
        self.surface = pygame.Surface((W, H))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.basket = pygame.Rect(0, GROUND - 6, 14, 6)
        self.basket.centerx = int(self.np_random.integers(20, 64))
        self.falling = []
        self.time = 0
        self.basketful = 0
        self.mistakes = 0
        self.pause = 5
        return self.observe(), self.info()

    def step(self, action):
        direction, hurry = int(action[0]), bool(action[1])
        self.time += 1
        pace = 5 if hurry else 3
        if direction == 3:
            self.basket.x = max(0, self.basket.x - pace)
        elif direction == 4:
            self.basket.right = min(W, self.basket.right + pace)
        self.grow()
        reward = self.fall()
        won = self.basketful >= NEEDED
        lost = self.mistakes >= MISTAKES
        terminated = won or lost
        if won:
            reward += 5.0
        truncated = self.time >= 600 and not terminated
        return self.observe(), reward, terminated, truncated, self.info()

    def grow(self):
        self.pause -= 1
        if self.pause <= 0:
            kind = "wasp" if self.np_random.random() < 0.25 else "apple"
            x = int(self.np_random.integers(4, W - 4))
            self.falling.append({"kind": kind, "x": x, "y": 8, "speed": int(self.np_random.integers(2, 4))})
            self.pause = int(self.np_random.integers(14, 22))

    def fall(self):
        reward = 0.0
        for thing in list(self.falling):
            thing["y"] += thing["speed"]
            if self.basket.collidepoint(thing["x"], thing["y"]):
                self.falling.remove(thing)
                if thing["kind"] == "apple":
                    self.basketful += 1
                    reward += 1.0
                else:
                    self.mistakes += 1
                    reward -= 1.0
            elif thing["y"] >= GROUND:
                self.falling.remove(thing)
                if thing["kind"] == "apple":
                    self.mistakes += 1
                    reward -= 0.5
        return reward

    def info(self):
        return {"is_success": self.basketful >= NEEDED, "apples": self.basketful, "mistakes": self.mistakes}

    def observe(self):
        self.surface.fill((132, 190, 226))
        pygame.draw.rect(self.surface, (88, 130, 60), (0, GROUND, W, H - GROUND))
        pygame.draw.ellipse(self.surface, (48, 96, 52), (-10, -14, W + 20, 26))
        for thing in self.falling:
            colour = (206, 46, 52) if thing["kind"] == "apple" else (240, 206, 40)
            pygame.draw.circle(self.surface, colour, (thing["x"], thing["y"]), 3)
        pygame.draw.rect(self.surface, (122, 78, 36), self.basket, border_radius=2)
        for i in range(self.basketful):
            pygame.draw.rect(self.surface, (206, 46, 52), (2 + 5 * i, H - 6, 4, 4))
        for i in range(self.mistakes):
            pygame.draw.rect(self.surface, (30, 30, 30), (W - 6 - 5 * i, H - 6, 4, 4))
        return pygame.surfarray.array3d(self.surface).swapaxes(0, 1).copy()

    def render(self):
        return self.observe()
