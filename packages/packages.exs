# Where the libraries come from that Hex would give (design: Packages without Hex). Every mix.exs that wants one says
# `Aerie.Packages.deps([:gnat])`; the environment decides what that means:
#
#   AERIE_PACKAGES unset      the ones in this folder, which have the public API of their namesakes
#   AERIE_PACKAGES=hex        the namesakes themselves, from Hex
#   AERIE_PACKAGES=<folder>   checkouts of the namesakes in that folder
defmodule Aerie.Packages do
  @requirements [telemetry: "~> 1.3", gnat: "~> 1.16", circuits_uart: "~> 1.5", phoenix_live_view: "~> 1.2"]

  def deps(names), do: Enum.map(names, &dep/1)

  defp dep(name) do
    requirement = Keyword.fetch!(@requirements, name)

    case System.get_env("AERIE_PACKAGES", "") do
      "" -> {name, path: Path.join(__DIR__, Atom.to_string(name))}
      "hex" -> {name, requirement}
      folder -> {name, path: Path.join(Path.expand(folder), Atom.to_string(name))}
    end
  end
end
