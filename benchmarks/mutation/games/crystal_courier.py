# contract: arcade-native
import gymnasium as gym
import numpy as np
import pygame
from gymnasium.spaces import Box, MultiDiscrete


class GameEnv(gym.Env):
    metadata = {"render_modes": ["rgb_array"], "render_fps": 30}

    user_guide = "Arrow keys fly the drone. Hold space to boost. Collect all crystals, avoid the patrols."
    game_description = "Fly a courier drone through a cave and collect every crystal before the battery is empty."
    auto_advance = True

    WIDTH, HEIGHT = 160, 120
    CRYSTALS = 5
    MAX_STEPS = 700
    BATTERY = 600

    COLOR_BG = (14, 16, 32)
    COLOR_DRONE = (90, 230, 160)
    COLOR_CRYSTAL = (120, 170, 255)
    COLOR_PATROL = (235, 80, 70)
    COLOR_UI = (240, 240, 240)

    def __init__(self, render_mode="rgb_array"):
        super().__init__()
        self.render_mode = render_mode
        self.observation_space = Box(low=0, high=255, shape=(self.HEIGHT, self.WIDTH, 3), dtype=np.uint8)
        self.action_space = MultiDiscrete([5, 2, 2])
        pygame.init()
        self.screen = pygame.Surface((self.WIDTH, self.HEIGHT))
        self.steps = 0
        self.score = 0
        self.game_over = False

    def reset(self, seed=None, options=None):
        super().reset(seed=seed)
        self.steps = 0
        self.score = 0
        self.hull = 3
        self.battery = self.BATTERY
        self.game_over = False
        self.win = False
        self.drone_pos = np.array([self.WIDTH / 2, self.HEIGHT - 14.0])
        self.crystals = []
        for _ in range(self.CRYSTALS):
            x = self.np_random.uniform(12, self.WIDTH - 12)
            y = self.np_random.uniform(16, self.HEIGHT - 30)
            self.crystals.append(np.array([x, y]))
        self.patrols = []
        for _ in range(2):
            self.patrols.append(
                {
                    "x": float(self.np_random.uniform(10, self.WIDTH - 10)),
                    "y": float(self.np_random.uniform(20, 80)),
                    "vx": float(self.np_random.choice([-1.5, 1.5])),
                }
            )
        self.hit_cooldown = 0
        return self._get_observation(), self._get_info()

    def step(self, action):
        movement = action[0]
        boost = action[1] == 1
        reward = 0.0
        self.steps += 1
        if not self.game_over:
            self._handle_input(movement, boost)
            reward += self._update_game_state()
        terminated = self.game_over
        truncated = self.steps >= self.MAX_STEPS and not terminated
        return self._get_observation(), reward, terminated, truncated, self._get_info()

    def _handle_input(self, movement, boost):
        speed = 4.0 if boost else 2.0
        self.battery -= 2 if boost else 1
        if movement == 1:
            self.drone_pos[1] -= speed
        elif movement == 2:
            self.drone_pos[1] += speed
        elif movement == 3:
            self.drone_pos[0] -= speed
        elif movement == 4:
            self.drone_pos[0] += speed
        self.drone_pos[0] = np.clip(self.drone_pos[0], 5, self.WIDTH - 5)
        self.drone_pos[1] = np.clip(self.drone_pos[1], 5, self.HEIGHT - 5)

    def _update_game_state(self):
        reward = 0.0
        for patrol in self.patrols:
            patrol["x"] += patrol["vx"]
            if patrol["x"] < 8 or patrol["x"] > self.WIDTH - 8:
                patrol["vx"] = -patrol["vx"]
            if (
                self.hit_cooldown == 0
                and np.hypot(patrol["x"] - self.drone_pos[0], patrol["y"] - self.drone_pos[1]) < 8
            ):
                self.hull -= 1
                self.hit_cooldown = 30
                reward -= 1.0
        self.hit_cooldown = max(0, self.hit_cooldown - 1)
        remaining = []
        for crystal in self.crystals:
            if np.linalg.norm(crystal - self.drone_pos) < 9:
                self.score += 1
                reward += 2.0
            else:
                remaining.append(crystal)
        self.crystals = remaining
        if not self.crystals:
            self.win = True
            self.game_over = True
            reward += 10.0
        elif self.hull <= 0 or self.battery <= 0:
            self.game_over = True
            reward -= 2.0
        return reward

    def _get_info(self):
        return {"score": self.score, "steps": self.steps, "hull": self.hull, "is_success": self.win}

    def _get_observation(self):
        self.screen.fill(self.COLOR_BG)
        self._render_game()
        self._render_ui()
        arr = pygame.surfarray.array3d(self.screen)
        return np.transpose(arr, (1, 0, 2)).astype(np.uint8)

    def _render_game(self):
        for crystal in self.crystals:
            x, y = int(crystal[0]), int(crystal[1])
            pygame.draw.polygon(self.screen, self.COLOR_CRYSTAL, [(x, y - 5), (x + 4, y), (x, y + 5), (x - 4, y)])
        for patrol in self.patrols:
            pygame.draw.circle(self.screen, self.COLOR_PATROL, (int(patrol["x"]), int(patrol["y"])), 5)
        color = (255, 255, 255) if self.hit_cooldown % 4 > 1 else self.COLOR_DRONE
        pygame.draw.rect(self.screen, color, (int(self.drone_pos[0]) - 5, int(self.drone_pos[1]) - 4, 10, 8))

    def _render_ui(self):
        pygame.draw.rect(self.screen, self.COLOR_UI, (4, 3, int(60 * max(self.battery, 0) / self.BATTERY), 4))
        for i in range(self.score):
            pygame.draw.rect(self.screen, self.COLOR_CRYSTAL, (80 + 8 * i, 3, 6, 5))
        for i in range(self.hull):
            pygame.draw.rect(self.screen, self.COLOR_PATROL, (130 + 8 * i, 3, 6, 5))

    def render(self):
        return self._get_observation()

    def close(self):
        pygame.quit()
