# Where the libraries come from that Hex would give (design: Packages without Hex). Every mix.exs that wants one says
# `Aerie.Packages.deps([:gnat])`; the environment decides what that means:
#
#   AERIE_PACKAGES unset      the ones in this folder, which have the public API of their namesakes
#   AERIE_PACKAGES=hex        the namesakes themselves, from Hex
#   AERIE_PACKAGES=<folder>   checkouts of the namesakes in that folder, and of what they depend on
#
# A namesake that is not in the folder is taken from here. nkey always is, because it has no namesake, and phoenix_live_view unless
# the folder has it: the namesake's pages need Phoenix's endpoint, which serves what the one here serves itself.
defmodule Aerie.Packages do
  @requirements [telemetry: "~> 1.4", gnat: "~> 1.16", circuits_uart: "~> 1.6"]
  @own [:nkey, :phoenix_live_view]

  def deps(names) do
    case System.get_env("AERIE_PACKAGES", "") do
      "" -> Enum.map(names, &own/1)
      "hex" -> hex(names)
      folder -> names |> checkouts(Path.expand(folder))
    end
  end

  defp hex(names) do
    Code.ensure_loaded?(Hex) ||
      Mix.raise("""
      AERIE_PACKAGES=hex: Hex is not installed. With a network, `AERIE_PACKAGES= mix local.hex` installs it; without one, take \
      checkouts (AERIE_PACKAGES=<folder>), or unset AERIE_PACKAGES for those in packages/.\
      """)

    Enum.map(names, &if(&1 in @own, do: own(&1), else: {&1, @requirements[&1]}))
  end

  # `override`: what they depend on would be asked of Hex. Each application names all of it, since it may use any of them first.
  defp checkouts(names, folder) do
    File.dir?(folder) || Mix.raise("AERIE_PACKAGES: there is no folder #{folder}")

    found =
      for path <- folder |> Path.join("*/mix.exs") |> Path.wildcard(),
          do: path |> Path.dirname() |> Path.basename()

    others = found -- Enum.map(@own ++ names, &Atom.to_string/1)

    for(name <- names, do: if("#{name}" in found, do: checkout(name, folder), else: own(name))) ++
      for name <- others, do: checkout(name, folder)
  end

  defp checkout(name, folder), do: {:"#{name}", path: Path.join(folder, "#{name}"), override: true}
  defp own(name), do: {name, path: Path.join(__DIR__, "#{name}")}
end
