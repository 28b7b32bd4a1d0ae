pluginManagement {
    repositories {
        google()
        mavenCentral()
        gradlePluginPortal()
    }
}

dependencyResolutionManagement {
    repositories {
        google()
        mavenCentral()
    }
}

rootProject.name = "veiloc-example"
include(":app", ":veiloc")
project(":veiloc").projectDir = file("../../bindings/mobile/android")
