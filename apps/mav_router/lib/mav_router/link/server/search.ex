defmodule MavRouter.Link.Server.Search do
  @moduledoc """
  What a link needs to know before it searches for its serial port or baud rate: the ports and rates of the configuration,
  what was right the last time, and the ports of other links, which it leaves alone.
  """

  alias MavRouter.Link.Settings
  alias MavRouter.Link.Spec
  alias Aerie.Base.Names
  alias Aerie.Base.Store

  @doc "Adds that to the options of a specification; `found` is what was right the last time. Links that do not search keep theirs."
  @spec prepare(Spec.t(), Names.gateway(), map | nil) :: Spec.t()
  def prepare(%Spec{detect: nil} = spec, gateway, _found), do: %{spec | gateway: gateway}

  def prepare(spec, gateway, found) do
    configured = gateway |> Settings.options_of() |> Keyword.take([:serial_ports, :serial_bauds]) |> Map.new()
    own = %{hint: found, taken: taken(spec, gateway)}
    %{spec | gateway: gateway, options: configured |> Map.merge(spec.options) |> Map.merge(own)}
  end

  defp taken(%{detect: :baud}, _gateway), do: []

  # Links with MSP use serial ports, too.
  defp taken(%{id: id} = spec, gateway) do
    for %{id: other, spec: %{device: device} = their, local: local} <- Store.links(gateway),
        other != id and carrier(their) == carrier(spec),
        path = local || device,
        do: path
  end

  defp carrier(%{inner: inner, transport: transport}), do: inner || transport
end
