defmodule Aerie.Fleet.Operations.Supervisor do
  @moduledoc """
  The processes of `Aerie.Fleet.Operations`. A restart interrupts the operations that run; their commands go on.
  Options: `:gateway`; `:dir`, the folder of the operations, without which none outlives the gateway.
  """
  use Supervisor

  alias Aerie.Base.Names
  alias Aerie.Fleet.Bridge
  alias Aerie.Fleet.Bridge.Commands.Service
  alias Aerie.Fleet.Operations.{Request, Requests, Server}

  @spec start_link(keyword()) :: Supervisor.on_start()
  def start_link(options),
    do: Supervisor.start_link(__MODULE__, options, name: Names.via(options[:gateway], :operations_supervisor))

  @impl Supervisor
  def init(options) do
    gateway = options[:gateway]
    Process.set_label({:operations, gateway})
    Supervisor.init([{Server, options}, {Service, service(gateway)}], strategy: :rest_for_one)
  end

  defp service(gateway) do
    [
      gateway: gateway,
      name: :operations_nats,
      operations: Requests.all(),
      subject: "fleet.#{Bridge.environment(gateway)}.#{Bridge.name(gateway)}.operation.*",
      max_bytes: Request.max_bytes()
    ]
  end
end
