# The modules of an app that other apps may name. Its README lists them, so that nobody adds one without noticing:
#
#     ## Used by other apps
#
#     ```
#     Aerie.Control: Commands, Missions
#     Aerie.Control.Policy: Lease, Roles
#     MavCodec.Messages: *
#     ```
#
# What only `aerie` names is not listed, because `aerie` wires all apps, with their settings and supervisors. Tests and
# benchmarks do not count either.
defmodule Layers.Readme do
  @root Path.expand("../../../..", __DIR__)
  @wiring :aerie

  def problems(apps) do
    problems(
      apps,
      for(app <- apps, into: %{}, do: {app.name, @root |> Path.join(file(app)) |> File.read!() |> listed()})
    )
  end

  @doc "`listed` has for each app the modules that its README lists."
  def problems(apps, listed) do
    used =
      for app <- apps,
          app.name != @wiring,
          {file, names} <- app.names,
          {owner, module} <- names,
          owner != app.name,
          do: {owner, module, "apps/#{app.name}/lib/#{file}.ex"}

    known = MapSet.new(used, fn {owner, module, _file} -> {owner, module} end)

    unlisted =
      for {owner, module, file} <- Enum.sort(used), module not in listed[owner] do
        "#{file} uses #{module}, which apps/#{owner}/README.md does not list under \"Used by other apps\"; " <>
          "use one that it lists, or add it there"
      end

    spare =
      for app <- apps,
          module <- listed[app.name],
          {app.name, module} not in known,
          do: "#{file(app)} lists #{module} under \"Used by other apps\", which no other app uses; remove it"

    unlisted ++ spare
  end

  @doc "The modules that the text of a README lists."
  def listed(text) do
    case Regex.run(~r/^## Used by other apps\n.*?^```\n(.*?)^```/ms, text) do
      [_, block] ->
        for line <- String.split(block, ~r/\n(?! )/, trim: true), module <- modules(line), do: module

      nil ->
        []
    end
  end

  defp modules(line) do
    case String.split(line, ":") do
      [folder, names] -> for name <- String.split(names, ~r/[\s,]+/, trim: true), do: "#{folder}.#{name}"
      [module] -> [module]
    end
  end

  defp file(app), do: "apps/#{app.name}/README.md"
end
