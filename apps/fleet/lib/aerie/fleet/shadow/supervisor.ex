defmodule Aerie.Fleet.Shadow.Supervisor do
  @moduledoc """
  Supervises what the shadow loops of all vehicles share (`rest_for_one`):

  | child | what its crash costs |
  |---|---|
  | `Documents` | the lease, for a moment; documents come back from disk and NATS |
  | the tasks' supervisor | attempts under way: they count as refused, and are in the ledger |
  | `Service` | requests over NATS under way |
  | `Uplink`, on a leaf node with a `vehicle_id` | nothing: it compares with the hub again |

  The loops themselves are in the vehicles' trees (`Aerie.Fleet.Shadow.Loop`).
  """
  use Supervisor

  alias Aerie.Base.Names
  alias Aerie.Fleet.Bridge.Commands.Service
  alias Aerie.Fleet.Shadow.{Document, Documents, Metrics, Operations, Settings}
  alias Aerie.Fleet.Shadow.Documents.Uplink

  @spec start_link(gateway: Names.gateway(), settings: Settings.t()) :: Supervisor.on_start()
  def start_link(options),
    do: Supervisor.start_link(__MODULE__, options, name: Names.via(options[:gateway], :shadow))

  @impl Supervisor
  def init(options) do
    gateway = Keyword.fetch!(options, :gateway)
    %Settings{} = settings = Keyword.fetch!(options, :settings)
    Process.set_label({:shadow, gateway})
    Names.put_value(gateway, :shadow, settings)
    options = [gateway: gateway, settings: settings]

    Supervisor.init(
      [
        {Task.Supervisor, name: Names.via(gateway, :shadow_tasks)},
        {Documents.Server, options},
        {Service, service(gateway, settings.bridge.environment)}
      ] ++ if(Uplink.vehicle(settings), do: [{Uplink, options}], else: []),
      strategy: :rest_for_one,
      max_restarts: 10,
      max_seconds: 30
    )
  end

  # Gateways with one NATS share the subjects: each answers for any vehicle, heard or not, because the documents are in
  # NATS.
  defp service(gateway, environment) do
    [
      gateway: gateway,
      name: :shadow_nats,
      operations: Operations.all(),
      subject: "fleet.#{environment}.*.shadow.*",
      queue_group: "aerie-shadow",
      max_bytes: Document.max_bytes(),
      dropped: fn -> Metrics.count(gateway, :dropped) end
    ]
  end
end
