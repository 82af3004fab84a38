defmodule Aerie.Vehicle.Options do
  @moduledoc "The part of `Aerie.Vehicle.Settings` that one vehicle's processes need, read once when its tree starts."

  alias MavRouter.Identity
  alias Aerie.Base.Store
  alias Aerie.Vehicle.Settings

  # The same as in the settings.
  @same [
    :stale_us,
    :lost_us,
    :lost_high_latency_us,
    :request_streams,
    :timesync_us,
    :read_gcs_parameters,
    :battery_low,
    :battery_critical
  ]
  @of_gateway [:heartbeat, :heartbeat_type, :i_am_the_gcs]
  @own [:id, :key, :network, :system_id, :own_system, :own_component, :wants, :sampling]

  @enforce_keys @own ++ @same ++ @of_gateway
  defstruct @enforce_keys ++ [publisher: nil]

  @typedoc """
  * `:id` - public name, a NATS token
  * `:stale_us`, `:lost_us` - the silence after which the vehicle is stale, and lost
  * `:own_system`, `:own_component` - the gateway's own ids for this vehicle
  * `:heartbeat` - whether to send the gateway's heartbeat; `:heartbeat_type` - with which type
  * `:i_am_the_gcs` - the gateway is the operator's ground station
  * `:request_streams` - request state messages that do not come by themselves, and what clients want
  * `:wants` - the rates (1/s) that the gateway itself wants, by message id
  * `:timesync_us` - time between two measurements of the vehicle's clock; 0: none
  * `:read_gcs_parameters` - read which ground station the failsafe listens to
  * `:lost_high_latency_us` - the silence after which it is lost while only high-latency links hear it
  * `:battery_low`, `:battery_critical` - remaining charge (0..1) below which the events occur
  * `:sampling` - group => settings, see `Aerie.Vehicle.State.Sampling`
  * `:publisher` - the module of `Aerie.Vehicle.Session.Publisher`, nil for none
  """
  @type t :: %__MODULE__{
          id: String.t(),
          key: Store.vehicle_key(),
          network: String.t(),
          system_id: non_neg_integer(),
          stale_us: pos_integer(),
          lost_us: pos_integer(),
          own_system: pos_integer(),
          own_component: pos_integer(),
          heartbeat: boolean(),
          heartbeat_type: :onboard_controller | :gcs,
          i_am_the_gcs: boolean(),
          request_streams: boolean(),
          wants: %{non_neg_integer() => number()},
          timesync_us: non_neg_integer(),
          read_gcs_parameters: boolean(),
          lost_high_latency_us: pos_integer(),
          battery_low: float(),
          battery_critical: float(),
          sampling: %{atom() => map()},
          publisher: module() | nil
        }

  @doc """
  The options of a vehicle. `extra`, from `Aerie.Vehicle.Supervisor.ensure/3`, overrides single fields; unknown fields raise.
  """
  @spec new(Settings.t(), Store.vehicle_key(), keyword()) :: t()
  def new(%Settings{identity: identity} = settings, {network, system_id} = key, extra \\ []) do
    own = [
      id: id(settings, key),
      key: key,
      network: network,
      system_id: system_id,
      own_system: own_system(identity, system_id),
      own_component: identity.component_id,
      wants: wants(settings.streams),
      sampling: settings.sampling.groups
    ]

    taken =
      for {from, keys} <- [{settings, @same}, {identity, @of_gateway}],
          name <- keys,
          do: {name, Map.fetch!(from, name)}

    struct!(__MODULE__, Keyword.merge(own ++ taken, extra))
  end

  @doc "Whether a vehicle has its name from the configuration."
  @spec named?(Settings.t(), Store.vehicle_key()) :: boolean()
  def named?(settings, key), do: is_map_key(configured_ids(settings), key)

  @doc """
  A vehicle's public name: the configured one, otherwise `VID-` and the system id with three digits on the default network,
  `{network}-` and the digits on others.
  """
  @spec id(Settings.t(), Store.vehicle_key()) :: String.t()
  def id(%Settings{identity: identity} = settings, {network, system_id} = key) do
    configured = configured_ids(settings)
    number = system_id |> Integer.to_string() |> String.pad_leading(3, "0")
    plain = if(network == identity.network, do: "VID", else: network) <> "-" <> number

    cond do
      id = configured[key] -> id
      # The configuration gave this name to another vehicle.
      plain in Map.values(configured) -> "#{network}-sys-#{system_id}"
      true -> plain
    end
  end

  defp configured_ids(%Settings{identity: identity, vehicles: vehicles}) do
    listed =
      for vehicle <- vehicles,
          into: %{},
          do: {{vehicle[:network] || identity.network, vehicle.system_id}, vehicle.id}

    case identity do
      %{vehicle_id: nil} -> listed
      %{system_id: :auto} -> Map.put_new(listed, {identity.network, 1}, identity.vehicle_id)
      %{system_id: system} -> Map.put_new(listed, {identity.network, system}, identity.vehicle_id)
    end
  end

  # Aboard, `auto` becomes the id of the vehicle.
  defp own_system(%{system_id: :auto, vehicle_id: nil}, _system_id), do: elem(Identity.default_ids(), 0)
  defp own_system(%{system_id: :auto}, system_id), do: system_id
  defp own_system(%{system_id: system}, _system_id), do: system

  # The configuration refuses unknown message names.
  defp wants(streams) do
    for {name, hz} <- streams, id = MavCodec.Dialects.All.message_id(name), hz > 0, into: %{}, do: {id, hz}
  end
end
