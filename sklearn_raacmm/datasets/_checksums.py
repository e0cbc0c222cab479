"""SHA-256 checksums of the open data sets' files, as their authors published them."""

# Authors: The sklearn_raacmm developers
# SPDX-License-Identifier: BSD-3-Clause

# Arm -> placement of the two sockets -> hole_0.csv, hole_1.csv.
PANDA = {
    "panda_2": {
        "back_left": (
            "9ac0f8ab838a253443f4fbb4314103c99eec11702ab16f3202b276e542d6893c",
            "e0a264882c05e8efaba07fbac9a93ddda4622791ffd0d9d9b301f381cb823cb1",
        ),
        "back_right": (
            "4593fe8a60fb705d4a22af7b8dc39eed00d0858dad13cea8dc5a49eba8a3aa73",
            "4655bac5d6b89fab41dc32cfb08ab1f0b2815ecbc2668ac0b9cabc4c005dd7da",
        ),
        "front_center": (
            "c7aad08357e7e76758291125a6c80eb1953022148b51c9273b4ace3e17f0c8a5",
            "f434cb7bb742557837ff6dd1fb8f36c8b3d973437a9f7241803a0e56522c1ab1",
        ),
        "front_left": (
            "5dbe7e202a5cca38828640d0151966fe71a3d4ece3fb6fadc0eda20d7a80ec25",
            "b9fc61e1ec7c73278bb4dd5639165b49067c13d01c5b95cbee9c3d8c4f2e055e",
        ),
        "front_right": (
            "40a21cdb6eaa6f25195750df54da5d14d0bbcb975c2fca90f84055443f1cd085",
            "2518407643da102903646c85d689c09129fd2a45cc77f4a02e8ed95c2535eb2f",
        ),
        "high": (
            "d7f584e50e9c001566bbfe2fbf25a5d4204b9736a1a52807fdc50bac2e219bdb",
            "e55baaabfc8a4e1c28187d3ccc4e18e8cad83d809970dde4fe68b10f9e6feea6",
        ),
        "mid-high": (
            "efe6e9be622f31d86faa466d1763bcb137fb56813621268c775cb9a0b9839127",
            "0b631c351ba880ac702e3868d12f7778ce31561e27a5feec1cb4d3e0908a78bc",
        ),
        "mid_left": (
            "ad200ee139563340c387604f0e25f9e275222e73d7c04713dc71d9dbd29789bf",
            "7edfb3ac549576331162e285ddc67c1b474179c400daf3bee5a605a422efa980",
        ),
        "mid_right": (
            "e3538b8cd94fa13783797f9a01e9832fb821ba4f7cc1b9703905c1f8d5fcbbe2",
            "daf4b7f9c557166720cc54b86a539e2786702d84cc0b768659d810d32d197daa",
        ),
    },
    "panda_3": {
        "backcenter": (
            "be47cb91a497f4e13b443e68d74db9f6dc799ca1321c506b1b971cd987039841",
            "85c936cfc57d1af91239f7bc5e294993f01ea2e170168f28521e17940f54e699",
        ),
        "backleft": (
            "afb1d1b4d279e0cf6995996abe5833e02e61a3f92621cb38bdbc477ac49b111f",
            "84ba3cc75acae01c23f53bd965d0e048bc04d58f2271c4afd1de3118b95e2e2a",
        ),
        "backright": (
            "2f663c9a8523234f4011bb06ca123e1ff0e50a1478e2fcc876f40943005cdb70",
            "933268a33c8f8dbe45e7755d32fbdb0dc9276ffa1a7d3c67e3e0a26f67b1111b",
        ),
        "frontcenter": (
            "ca2a7d595fb90a6e9e112b7b78bc849b32691a1f764fe9623e762f060af5ceab",
            "cc7a53830159e4f7f058d04bfb33b64aa758f522757b01f3f6a09c57727033eb",
        ),
        "frontleft": (
            "2ff9f7f9cb03c76ba13735f6ba5083126c7dfd332cdf447f883e1f930b8a7a3c",
            "d7b9e45c036de5f6d574bb8f439ce1e24894adb88e9d41e3a948ab278e7cd49d",
        ),
        "frontright": (
            "4238c42b5bf33514241e3b7bb21e18cb3c9b01b8e35ef857898b1660e5ee349e",
            "c8e6f3586d2b10b53373c473d59c5de818794f8a8fab579b37231a9703e5caae",
        ),
    },
}
UR10 = "84d5c81234cab58ebe88b4c73c582c26ad0e407f0de5350571c91f5ce6f28b76"
