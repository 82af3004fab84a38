defmodule Aerie.Fleet.Shadow.Settings do
  @moduledoc "The shadow: whether vehicles are made to agree with their desired state, and who keeps that."
  use Aerie.Base.Settings

  import Aerie.Base.Settings.Rules

  alias Aerie.Fleet.Shadow.Store.Buckets

  part :bridge, Aerie.Fleet.Bridge.Settings

  section "shadow",
          "Desired and reported state of vehicles (docs/shadow.md). Nothing is desired unless somebody with the permission says so."

  setting :enabled,
          :boolean,
          "Whether vehicles are made to agree with what is desired of them. If not, differences are only shown.",
          default: true

  setting :hold_us,
          {:number, 0, 86_400},
          """
          How long the shadow stays away from a vehicle after a pilot, a failsafe, an operator or another ground station was in charge
          of it.
          """,
          key: "hold_s",
          default: 30.0,
          times: 1_000_000

  setting :allow_arming,
          :boolean,
          "Whether the field armed is heeded. If not, it is refused. What it takes besides is in docs/shadow.md.",
          default: false

  setting :max_tries,
          {:integer, 1, 20},
          "How often a field is tried before it counts as refused.",
          default: 6

  setting :without_nats,
          {:enum, [:hold, :act]},
          """
          What the shadow does while the servers at nats.url cannot be reached, and what becomes of commands: hold, because another
          gateway may have taken over, so no command is sent; or act, for a gateway that is the only one to hear its vehicles.
          """,
          default: :hold

  setting :lease_ms,
          {:number, 1, 600},
          "One of the gateways that hear a vehicle acts. Another one takes over when it was silent for one and a half times this.",
          key: "lease_s",
          default: 10.0,
          times: 1000

  setting :dir, :path, "Folder with copies of the desired states, and with operations, for its owner only.",
    default: "var/shadow"

  setting :buckets,
          {:section, bucket_fields()},
          "The buckets, made if they are not there. Their copies in a cluster: nats.streams.replicas."

  setting :key,
          :secret,
          """
          Gateways heed desired states, leases and signs of life only of gateways with the same key, of 16
          characters or more, from which each vehicle's own is derived. It opens all vehicles' desired states,
          so it belongs at the hub; a companion has a vehicle_key. Left out: a random one of this gateway, in
          shadow.dir, so that it heeds no other gateway.
          """,
          example: "a long random text"

  setting :vehicle_key,
          :secret,
          "Aboard: the key of the vehicle of vehicle_id alone, in the place of key. bin/nats-setup derives it.",
          example: "a long random text"

  setting :hub,
          :string,
          """
          Aboard, on a leaf node: who the hub is, a name of policy.sources. What is desired at the hub needs the permissions that this source has; with nobody of
          that name the hub desires in vain.
          """,
          default: "hub"

  setting :former_key,
          :secret,
          """
          The key before the present one: desired states that were sealed with it are read and sealed again. Remove it once all of
          them have been.
          """,
          example: "a long random text"

  defp bucket_fields do
    [
      field(
        :desired_max_mb,
        {:integer, 1, 1_048_576},
        "Size of fleet_desired. When it is full, no desired state can be changed.",
        default: 64
      ),
      field(
        :desired_history,
        {:integer, 1, 64},
        "Documents that fleet_desired keeps of each vehicle, the present one included.",
        default: 5
      ),
      field(
        :reported_max_mb,
        {:integer, 1, 1_048_576},
        "Size of fleet_reported. When it is full, reports get old.",
        default: 32
      ),
      field(
        :reported_max_age_days,
        {:number, 0, 3650},
        "Age at which a report goes, of a vehicle that is long gone; 0 keeps it.",
        default: 0.0
      ),
      field(
        :plans_max_mb,
        {:integer, 1, 1_048_576},
        "Size of fleet_plans. When it is full, no plan can be stored.",
        default: 32
      ),
      field(
        :plans_max_age_days,
        {:number, 0, 3650},
        "Age at which a plan file goes, used or not; 0 keeps it. Gateways have copies of the last 300.",
        default: 0.0
      )
    ]
  end

  @shortest 16

  # A reader of sealed documents can try keys offline.
  @impl Aerie.Base.Settings
  def problems(%{shadow: shadow, vehicle_id: id}) do
    short =
      for name <- [:key, :vehicle_key, :former_key],
          key = Map.fetch!(shadow, name),
          key != nil and byte_size(Aerie.Base.Secret.reveal(key)) < @shortest,
          do: {true, ["shadow", "#{name}"], "#{@shortest} characters or more", "a shorter one"}

    failed(
      short ++
        [
          {shadow.vehicle_key != nil and shadow.key != nil, ["shadow", "vehicle_key"],
           "shadow.key, from which all keys are derived, or shadow.vehicle_key, not both", "both"},
          {shadow.vehicle_key != nil and id == nil, ["shadow", "vehicle_key"],
           "vehicle_id, the vehicle whose key it is", "no vehicle_id"}
        ]
    )
  end

  @impl Aerie.Base.Settings
  def warnings(%{nats: nats, shadow: %{buckets: buckets} = shadow}) do
    needed = nats.streams.state_max_mb + nats.streams.event_max_mb + Buckets.reserved_mb(buckets)

    texts([
      {nats.mode == :embedded and nats.max_store_mb < needed,
       "nats.max_store_mb is #{nats.max_store_mb}: the server has no room for the shadow's buckets, so no desired state can be " <>
         "stored. With the streams as configured it takes #{needed}."},
      {nats.mode == :url and shadow.key == nil and shadow.vehicle_key == nil,
       "shadow.key is not set: this gateway heeds no lease of another one at nats.url, and no other one heeds its " <>
         "own, so two that hear the same vehicle both act on it. Give all of them the same shadow.key."}
    ])
  end
end
