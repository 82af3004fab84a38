defmodule Aerie.Vehicle.Options do
  @moduledoc """
  What one vehicle's processes need to know of the configuration, looked up once when its tree starts.

  Missing keys have defaults, so that a test can start a vehicle from a plain map with the few keys it is about.
  """

  alias Aerie.Store

  @hub elem(Aerie.Identity.default_ids(), 0)
  @component elem(Aerie.Identity.default_ids(), 1)

  @enforce_keys [:id, :key, :network, :system_id]
  defstruct [
    :id,
    :key,
    :network,
    :system_id,
    stale_us: 3_000_000,
    lost_us: 5_000_000,
    own_system: @hub,
    own_component: @component,
    heartbeat: true,
    heartbeat_type: :onboard_controller,
    i_am_the_gcs: false,
    request_streams: true,
    wants: %{},
    timesync_us: 10_000_000,
    read_gcs_parameters: true,
    lost_high_latency_us: 180_000_000,
    battery_low: 0.25,
    battery_critical: 0.10,
    sampling: %{},
    fleet: nil
  ]

  @typedoc """
  * `:id` - public name, a NATS token
  * `:stale_us`, `:lost_us` - silence after which the vehicle counts as stale, as lost
  * `:own_system`, `:own_component` - what the gateway calls itself towards this vehicle
  * `:heartbeat` - send it the gateway's heartbeat; `:heartbeat_type` - as what
  * `:i_am_the_gcs` - the gateway stands for the operator's ground station
  * `:request_streams` - ask it for state messages that do not come by themselves, and for what clients want
  * `:wants` - messages per second by message id that the gateway itself wants in any case
  * `:timesync_us` - time between two measurements of its clock, 0 for none
  * `:read_gcs_parameters` - read which ground station its failsafe listens to
  * `:lost_high_latency_us` - silence after which it counts as lost while only high-latency links hear it
  * `:battery_low`, `:battery_critical` - remaining charge (0..1) below which the events are given
  * `:sampling` - group => settings, see `Aerie.Vehicle.Sampling`
  * `:fleet` - the module of `Aerie.Vehicle.Fleet`, nil for none
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
          fleet: module() | nil
        }

  @doc """
  The options of a vehicle. `extra` overrides single fields of the result, as `Aerie.Vehicle.Supervisor.ensure/3` was
  given them; unknown fields raise.
  """
  @spec new(term(), Store.vehicle_key(), keyword()) :: t()
  def new(config, {network, system_id} = key, extra \\ []) do
    defaults = %__MODULE__{id: id(config, key), key: key, network: network, system_id: system_id}
    companion = get(config, [:vehicle_id], nil) != nil

    struct!(
      %{
        defaults
        | stale_us: us(get(config, [:timeouts, :vehicle_stale_s], 3.0)),
          lost_us: us(get(config, [:timeouts, :vehicle_lost_s], 5.0)),
          own_system: own_system(config) || if(companion, do: system_id, else: @hub),
          own_component: get(config, [:mavlink, :component_id], @component),
          heartbeat: get(config, [:mavlink, :heartbeat], true),
          heartbeat_type: get(config, [:mavlink, :heartbeat_type], :onboard_controller),
          i_am_the_gcs: get(config, [:mavlink, :i_am_the_gcs], false),
          request_streams: get(config, [:mavlink, :request_streams], true),
          wants: wants(get(config, [:mavlink, :streams], %{})),
          timesync_us: us(get(config, [:mavlink, :timesync_s], 10.0)),
          read_gcs_parameters: get(config, [:mavlink, :read_gcs_parameters], true),
          lost_high_latency_us: us(get(config, [:timeouts, :vehicle_lost_high_latency_s], 180.0)),
          battery_low: get(config, [:events, :battery_low], defaults.battery_low),
          battery_critical: get(config, [:events, :battery_critical], defaults.battery_critical),
          sampling: get(config, [:sampling, :groups], %{})
      },
      extra
    )
  end

  @doc "The configured bound on the number of vehicles, or nil."
  @spec max_vehicles(term()) :: pos_integer() | nil
  def max_vehicles(config), do: get(config, [:limits, :max_vehicles], nil)

  @doc "How long a vehicle must be lost before a new one takes its place (`Aerie.Vehicle.Places`)."
  @spec displace_lost_s(term(), number()) :: number()
  def displace_lost_s(config, default), do: get(config, [:limits, :displace_lost_s], default)

  @doc "Whether a vehicle has its name from the configuration."
  @spec named?(term(), Store.vehicle_key()) :: boolean()
  def named?(config, key), do: is_map_key(configured_ids(config), key)

  @doc """
  A vehicle's public name: the configured one, else `VID-` and the system id with three digits on the default network,
  `{network}-` and the same on others.
  """
  @spec id(term(), Store.vehicle_key()) :: String.t()
  def id(config, {network, system_id} = key) do
    configured = configured_ids(config)
    default_network = get(config, [:network], "main")
    number = system_id |> Integer.to_string() |> String.pad_leading(3, "0")
    plain = if(network == default_network, do: "VID", else: network) <> "-" <> number

    cond do
      id = configured[key] -> id
      # The configuration gave this name to another vehicle.
      plain in Map.values(configured) -> "#{network}-sys-#{system_id}"
      true -> plain
    end
  end

  defp configured_ids(config) do
    default_network = get(config, [:network], "main")

    listed =
      for vehicle <- get(config, [:vehicles], []), into: %{} do
        {{get(vehicle, [:network], nil) || default_network, get(vehicle, [:system_id], nil)},
         get(vehicle, [:id], nil)}
      end

    case get(config, [:vehicle_id], nil) do
      nil -> listed
      id -> Map.put_new(listed, {default_network, own_system(config) || 1}, id)
    end
  end

  # What is to be found out is the vehicle's own, whichever it is.
  defp own_system(config) do
    with :auto <- get(config, [:mavlink, :system_id], nil), do: nil
  end

  # Names that are no messages were refused with the configuration.
  defp wants(streams) do
    for {name, hz} <- streams, id = MavCodec.Dialects.All.message_id(name), hz > 0, into: %{}, do: {id, hz}
  end

  defp us(seconds), do: round(seconds * 1_000_000)

  defp get(value, [], default), do: if(is_nil(value), do: default, else: value)
  defp get(%{} = map, [key | rest], default), do: map |> Map.get(key) |> get(rest, default)
  defp get(_absent, _path, default), do: default
end
