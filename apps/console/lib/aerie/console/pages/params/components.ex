defmodule Aerie.Console.Pages.Params.Components do
  @moduledoc "The components of a vehicle, beside its autopilot, that may have parameters of their own (PARAM_EXT, P8)."

  alias Aerie.Base.{Names, Store}

  @doc "Names and numbers of those of a vehicle (its snapshot), in the order of the numbers; `asked` is among them though it was not heard."
  @spec others(Names.gateway(), map(), asked :: 1..255 | nil) :: [{String.t(), 1..255}]
  def others(gateway, %{key: key} = vehicle, asked) do
    heard = (Store.system(gateway, key) || %{components: %{}}).components
    autopilot = vehicle.component || 1

    for component <- Enum.sort(Enum.uniq(Map.keys(heard) ++ List.wrap(asked))),
        component not in [0, autopilot],
        do: {name(component, heard[component]), component}
  end

  defp name(component, nil), do: "component #{component}"
  defp name(component, %{role: role}), do: "#{String.replace(role, "_", " ")} (#{component})"
end
