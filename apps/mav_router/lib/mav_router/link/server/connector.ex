defmodule MavRouter.Link.Server.Connector do
  @moduledoc """
  Opens a connection in a process of its own: a slow name server, a host that does not answer or a device that hangs never
  blocks the link's process, and opening can be aborted at any time.

  It is linked to the link's process, which traps exits and gets `{:opener, pid, {:ok, conn} | {:error, reason}}`, or the
  exit of an opener that crashed.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Base.Net.PortOwner
  alias MavRouter.Link.Settings
  alias MavRouter.Link.Spec

  @doc """
  A specification with what a link needs to know before it searches for its serial port or baud rate: the ports and
  rates of the configuration, what was right the last time (`found`), and the ports of other links, which it leaves
  alone.
  """
  @spec prepare(Spec.t(), Names.gateway(), map | nil) :: Spec.t()
  def prepare(%Spec{detect: nil} = spec, gateway, _found), do: %{spec | gateway: gateway}

  def prepare(spec, gateway, found) do
    configured = gateway |> Settings.options_of() |> Keyword.take([:serial_ports, :serial_bauds]) |> Map.new()
    own = %{hint: found, taken: taken(spec, gateway)}
    %{spec | gateway: gateway, options: configured |> Map.merge(spec.options) |> Map.merge(own)}
  end

  defp taken(%{detect: :baud}, _gateway), do: []

  # Links with MSP use serial ports as well.
  defp taken(%{id: id} = spec, gateway) do
    for %{id: other, spec: %{device: device} = their, local: local} <- Store.links(gateway),
        other != id and carrier(their) == carrier(spec),
        path = local || device,
        do: path
  end

  defp carrier(%{inner: inner, transport: transport}), do: inner || transport

  @doc "Starts opening; the calling process is the link."
  @spec start(Spec.t()) :: pid
  def start(%Spec{} = spec) do
    link = self()

    spawn_link(fn ->
      Process.set_label({:opener, spec.id})

      result =
        with {:ok, conn} <- spec.transport.open(spec),
             :ok <- spec.transport.give(conn, link),
             do: {:ok, conn}

      send(link, {:opener, self(), explain(result, spec)})
    end)
  end

  # Finding the owner reads much of /proc: too slow for the link's process.
  defp explain({:error, :eaddrinuse}, spec) do
    own = String.to_integer(System.pid())

    case PortOwner.find(spec.protocol, spec.port) do
      {:ok, _program, ^own} -> {:error, {:in_use, "this gateway (process #{own})"}}
      {:ok, program, pid} -> {:error, {:in_use, "#{program} (process #{pid})"}}
      :unknown -> {:error, {:in_use, "another program"}}
    end
  end

  defp explain(result, _spec), do: result
end
