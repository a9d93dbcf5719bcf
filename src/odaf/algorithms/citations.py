"""The papers that learners and terms implement, as data; a learner or a term says which of them it is.

A field that is not known for certain is left out.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Citation:
    """A publication, or a piece of software.

    Attributes:
        key: under which BibTeX knows it.
        authors: first names first.
        title: as printed.
        year: of the publication; 0 for software, whose version says more.
        venue: proceedings, in full; empty for a preprint and for software.
        arxiv: number of the preprint; empty without one.
        note: what else must be said, such as the version of software.
    """

    key: str
    authors: tuple[str, ...]
    title: str
    year: int
    venue: str = ""
    arxiv: str = ""
    note: str = ""
    group: bool = False
    """The authors are a group, whose name has no first and last part."""

    def bibtex(self) -> str:
        """One entry of a BibTeX file."""
        fields = {
            "author": " and ".join(f"{{{author}}}" if self.group else author for author in self.authors),
            "title": f"{{{self.title}}}",  # doubled braces keep the capitals
            "booktitle": self.venue,
            "year": str(self.year) if self.year else "",
            "eprint": self.arxiv,
            "archivePrefix": "arXiv" if self.arxiv else "",
            "note": self.note,
        }
        kind = "inproceedings" if self.venue else "misc"
        lines = [f"  {name} = {{{value}}}," for name, value in fields.items() if value]
        return "\n".join([f"@{kind}{{{self.key},", *lines, "}"])

    def text(self) -> str:
        """One line for a reader."""
        *others, last = self.authors
        authors = f"{', '.join(others)} and {last}" if others else last
        parts = [f"{authors}. {self.title}"]
        parts += [part for part in (self.venue, self.arxiv and f"arXiv {self.arxiv}", self.note) if part]
        return f"{'. '.join(parts)}{f', {self.year}' if self.year else ''}."


_NEURIPS = "Advances in Neural Information Processing Systems"

ODAF = Citation(
    "jiang2025odaf",
    ("Ke Jiang", "Wen Jiang", "Yao Li", "Xiaoyang Tan"),
    "Beyond Non-Expert Demonstrations: Outcome-Driven Action Constraint for Offline Reinforcement Learning",
    2025,
    arxiv="2504.01719",
)
SAC = Citation(
    "haarnoja2018sac",
    ("Tuomas Haarnoja", "Aurick Zhou", "Pieter Abbeel", "Sergey Levine"),
    "Soft Actor-Critic: Off-Policy Maximum Entropy Deep Reinforcement Learning with a Stochastic Actor",
    2018,
    "International Conference on Machine Learning",
    "1801.01290",
)
ENSEMBLES = Citation(
    "an2021edac",
    ("Gaon An", "Seungyong Moon", "Jang-Hyun Kim", "Hyun Oh Song"),
    "Uncertainty-Based Offline Reinforcement Learning with Diversified Q-Ensemble",
    2021,
    _NEURIPS,
    "2110.01548",
)
PBRL = Citation(
    "bai2022pbrl",
    (
        "Chenjia Bai",
        "Lingxiao Wang",
        "Zhuoran Yang",
        "Zhihong Deng",
        "Animesh Garg",
        "Peng Liu",
        "Zhaoran Wang",
    ),
    "Pessimistic Bootstrapping for Uncertainty-Driven Offline Reinforcement Learning",
    2022,
    "International Conference on Learning Representations",
    "2202.11566",
)
RORL = Citation(
    "yang2022rorl",
    ("Rui Yang", "Chenjia Bai", "Xiaoteng Ma", "Zhaoran Wang", "Chongjie Zhang", "Lei Han"),
    "RORL: Robust Offline Reinforcement Learning via Conservative Smoothing",
    2022,
    _NEURIPS,
    "2206.02829",
)
CQL = Citation(
    "kumar2020cql",
    ("Aviral Kumar", "Aurick Zhou", "George Tucker", "Sergey Levine"),
    "Conservative Q-Learning for Offline Reinforcement Learning",
    2020,
    _NEURIPS,
    "2006.04779",
)
OSR = Citation(
    "jiang2023osr",
    ("Ke Jiang", "Jia-Yu Yao", "Xiaoyang Tan"),
    "Recovering from Out-of-sample States via Inverse Dynamics in Offline Reinforcement Learning",
    2023,
    _NEURIPS,
)
TD3_BC = Citation(
    "fujimoto2021td3bc",
    ("Scott Fujimoto", "Shixiang Shane Gu"),
    "A Minimalist Approach to Offline Reinforcement Learning",
    2021,
    _NEURIPS,
    "2106.06860",
)
IQL = Citation(
    "kostrikov2022iql",
    ("Ilya Kostrikov", "Ashvin Nair", "Sergey Levine"),
    "Offline Reinforcement Learning with Implicit Q-Learning",
    2022,
    "International Conference on Learning Representations",
    "2110.06169",
)
REBRAC = Citation(
    "tarasov2023rebrac",
    ("Denis Tarasov", "Vladislav Kurenkov", "Alexander Nikulin", "Sergey Kolesnikov"),
    "Revisiting the Minimalist Approach to Offline Reinforcement Learning",
    2023,
    _NEURIPS,
    "2305.09836",
)
SPOT = Citation(
    "wu2022spot",
    ("Jialong Wu", "Haixu Wu", "Zihan Qiu", "Jianmin Wang", "Mingsheng Long"),
    "Supported Policy Optimization for Offline Reinforcement Learning",
    2022,
    _NEURIPS,
    "2202.06239",
)
SVR = Citation(
    "mao2023svr",
    ("Yixiu Mao", "Hongchang Zhang", "Chen Chen", "Yi Xu", "Xiangyang Ji"),
    "Supported Value Regularization for Offline Reinforcement Learning",
    2023,
    _NEURIPS,
)
SCAS = Citation(
    "mao2024scas",
    ("Yixiu Mao", "Qi Wang", "Chen Chen", "Yun Qu", "Xiangyang Ji"),
    "Offline Reinforcement Learning with OOD State Correction and OOD Action Suppression",
    2024,
    _NEURIPS,
    "2410.19400",
)
BCQ = Citation(
    "fujimoto2019bcq",
    ("Scott Fujimoto", "David Meger", "Doina Precup"),
    "Off-Policy Deep Reinforcement Learning without Exploration",
    2019,
    "International Conference on Machine Learning",
    "1812.02900",
)
BEAR = Citation(
    "kumar2019bear",
    ("Aviral Kumar", "Justin Fu", "Matthew Soh", "George Tucker", "Sergey Levine"),
    "Stabilizing Off-Policy Q-Learning via Bootstrapping Error Reduction",
    2019,
    _NEURIPS,
    "1906.00949",
)
BRAC = Citation(
    "wu2019brac",
    ("Yifan Wu", "George Tucker", "Ofir Nachum"),
    "Behavior Regularized Offline Reinforcement Learning",
    2019,
    "",
    "1911.11361",
)
MOPO = Citation(
    "yu2020mopo",
    (
        "Tianhe Yu",
        "Garrett Thomas",
        "Lantao Yu",
        "Stefano Ermon",
        "James Zou",
        "Sergey Levine",
        "Chelsea Finn",
        "Tengyu Ma",
    ),
    "MOPO: Model-based Offline Policy Optimization",
    2020,
    _NEURIPS,
    "2005.13239",
)
COMBO = Citation(
    "yu2021combo",
    ("Tianhe Yu", "Aviral Kumar", "Rafael Rafailov", "Aravind Rajeswaran", "Sergey Levine", "Chelsea Finn"),
    "COMBO: Conservative Offline Model-Based Policy Optimization",
    2021,
    _NEURIPS,
    "2102.08363",
)
ATAC = Citation(
    "cheng2022atac",
    ("Ching-An Cheng", "Tengyang Xie", "Nan Jiang", "Alekh Agarwal"),
    "Adversarially Trained Actor Critic for Offline Reinforcement Learning",
    2022,
    "International Conference on Machine Learning",
    "2202.02446",
)
SDC = Citation(
    "zhang2022sdc",
    ("Hongchang Zhang", "Jianzhun Shao", "Yuhang Jiang", "Shuncheng He", "Guanwen Zhang", "Xiangyang Ji"),
    "State Deviation Correction for Offline Reinforcement Learning",
    2022,
    "AAAI Conference on Artificial Intelligence",
)
MBRCSL = Citation(
    "zhou2024free",
    ("Zhaoyi Zhou", "Chuning Zhu", "Runlong Zhou", "Qiwen Cui", "Abhishek Gupta", "Simon Shaolei Du"),
    "Free from Bellman Completeness: Trajectory Stitching via Model-based Return-conditioned Supervised Learning",
    2024,
    "International Conference on Learning Representations",
    "2310.19308",
)
DENOISING_DIFFUSION = Citation(
    "ho2020denoising",
    ("Jonathan Ho", "Ajay Jain", "Pieter Abbeel"),
    "Denoising Diffusion Probabilistic Models",
    2020,
    _NEURIPS,
    "2006.11239",
)
CLONING = Citation(
    "pomerleau1988alvinn",
    ("Dean A. Pomerleau",),
    "ALVINN: An Autonomous Land Vehicle in a Neural Network",
    1988,
    _NEURIPS,
)
TRAJECTORY_WEIGHTING = Citation(
    "hong2023harnessing",
    ("Zhang-Wei Hong", "Pulkit Agrawal", "Rémi Tachet des Combes", "Romain Laroche"),
    "Harnessing Mixed Offline Reinforcement Learning Datasets via Trajectory Weighting",
    2023,
    "International Conference on Learning Representations",
    "2306.13085",
)
IMBALANCED_DATASETS = Citation(
    "hong2023beyond",
    (
        "Zhang-Wei Hong",
        "Aviral Kumar",
        "Sathwik Karnik",
        "Abhishek Bhandwaldar",
        "Akash Srivastava",
        "Joni Pajarinen",
        "Romain Laroche",
        "Abhishek Gupta",
        "Pulkit Agrawal",
    ),
    "Beyond Uniform Sampling: Offline Reinforcement Learning with Imbalanced Datasets",
    2023,
    _NEURIPS,
    "2310.04413",
)
DECISION_TRANSFORMER = Citation(
    "chen2021decision",
    (
        "Lili Chen",
        "Kevin Lu",
        "Aravind Rajeswaran",
        "Kimin Lee",
        "Aditya Grover",
        "Michael Laskin",
        "Pieter Abbeel",
        "Aravind Srinivas",
        "Igor Mordatch",
    ),
    "Decision Transformer: Reinforcement Learning via Sequence Modeling",
    2021,
    _NEURIPS,
    "2106.01345",
)
PRIORS = Citation(
    "osband2018priors",
    ("Ian Osband", "John Aslanides", "Albin Cassirer"),
    "Randomized Prior Functions for Deep Reinforcement Learning",
    2018,
    _NEURIPS,
    "1806.03335",
)


def software(version: str) -> Citation:
    """This package, as CITATION.cff has it."""
    return Citation("odaf", ("The odaf contributors",), "odaf", 0, note=f"Software, version {version}", group=True)
