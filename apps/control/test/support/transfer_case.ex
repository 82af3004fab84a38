defmodule Aerie.TransferCase do
  @moduledoc "Tests of transfers: a gateway that takes commands, and a simulated vehicle behind a UDP link on the loopback."
  use ExUnit.CaseTemplate

  import Aerie.GatewayCase, only: [eventually: 1]
  import Aerie.LinkCase, only: [add_link: 3]

  alias Aerie.{CommandCase, VehicleCase}
  alias Aerie.Base.Store
  alias Aerie.Control.{Commands, Params, Policy}

  using do
    quote do
      import Aerie.TransferCase
      import Aerie.GatewayCase, only: [eventually: 1]
      alias Aerie.Vehicle.Command.Result
      alias Aerie.Base.Store
    end
  end

  @doc "A gateway with links, vehicles and commands; gives its name and the port of its link. `policy` is that section."
  @spec start(Path.t(), map()) :: {reference(), :inet.port_number()}
  def start(dir, policy \\ %{}) do
    # A vehicle that a busy machine keeps from running is not lost.
    gateway = VehicleCase.start_parts(%{timeouts: %{vehicle_stale_s: 60.0, vehicle_lost_s: 120.0}})
    audit = %{dir: Path.join(dir, "audit"), max_mb: 8, required: true}
    config = %{policy: Map.merge(%{audit: audit}, policy), commands: CommandCase.commands(dir)}
    config = Map.put(config, :params, %{dir: Path.join(dir, "params")})

    for part <- [Policy.Store.Supervisor, Commands.Supervisor, Params.Cache.Writer],
        do: CommandCase.start_part(part, gateway, config)

    {_id, port} = add_link(gateway, "udpin:127.0.0.1:0", id: "radio")
    {gateway, port}
  end

  @doc "A simulated vehicle that the gateway knows; gives its process. Faults are for both directions, once it is known."
  @spec fly(reference(), :inet.port_number(), keyword()) :: pid()
  def fly(gateway, port, options) do
    {faults, options} = Keyword.split(options, [:loss, :duplicate])
    options = [link: "udpout:127.0.0.1:#{port}", ready_s: 0.5, seed: 7] ++ options
    sim = ExUnit.Callbacks.start_supervised!({SimVehicle, options}, id: options[:system] || 1)

    eventually(fn ->
      case Store.vehicle(gateway, {"main", options[:system] || 1}) do
        %{capabilities: bits, clock: %{rtt_us: us}} when is_integer(bits) and is_integer(us) -> true
        _not_yet -> false
      end
    end)

    for {name, value} <- faults,
        direction <- [:in, :out],
        do: :ok = SimVehicle.fault(sim, name, value, direction)

    sim
  end
end
