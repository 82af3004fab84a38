defmodule MavRouter.Identity.Heartbeat do
  @every_ms 1_000
  @claimed_ms 900
  @withheld_ms 3_000

  @moduledoc """
  The gateway's heartbeat: what it says, whether it may be sent, and how often.

  - It says MAV_AUTOPILOT_INVALID (H2) and MAV_TYPE_ONBOARD_CONTROLLER, which no firmware takes for an operator's, or
    MAV_TYPE_GCS if the gateway is the ground station (`mavlink.i_am_the_gcs`, H5). MAV_STATE_CRITICAL: a part of the
    gateway does not answer on which the receiver does not depend.
  - It works as a dead man's switch: it is sent only while the loops that it vouches for answer
    (`MavRouter.Identity.Watchdog`, H3). What is held back is counted as `{:identity, :held}`.
  - It is sent once in #{@every_ms} ms by each path (link and peer) to vehicles, however many of them are
    there: the first session that is due claims the path. Links that hear nothing get it from
    `MavRouter.Link.Announcer`.
  """

  alias Aerie.Base.{Names, Store}
  alias MavCodec.Enums.{MavAutopilot, MavState, MavType}
  alias MavCodec.Messages.Heartbeat
  alias MavRouter.Endpoints.Endpoint
  alias MavRouter.Identity.Watchdog

  @types %{
    onboard_controller: MavType.value(:MAV_TYPE_ONBOARD_CONTROLLER),
    gcs: MavType.value(:MAV_TYPE_GCS)
  }
  @autopilot_invalid MavAutopilot.value(:MAV_AUTOPILOT_INVALID)
  @active MavState.value(:MAV_STATE_ACTIVE)
  @critical MavState.value(:MAV_STATE_CRITICAL)

  @typedoc "`mavlink.heartbeat_type`."
  @type kind :: :onboard_controller | :gcs

  @doc "The time between two heartbeats by one path, in ms."
  @spec every_ms() :: pos_integer
  def every_ms, do: @every_ms

  @doc "The MAV_TYPE of our heartbeat."
  @spec type(kind) :: 0..255
  def type(kind), do: Map.fetch!(@types, kind)

  @doc """
  Our heartbeat to a vehicle (its key), or to whatever is at the other end of a link (nil); `:held` while a loop that it
  vouches for does not answer.
  """
  @spec message(Names.gateway(), MavRouter.Router.vehicle_key() | nil, kind) :: Heartbeat.t() | :held
  def message(gateway, vehicle, kind) do
    case Watchdog.silent(gateway, vehicle) do
      [] ->
        %Heartbeat{
          type: type(kind),
          autopilot: @autopilot_invalid,
          system_status: if(Watchdog.any_silent?(gateway), do: @critical, else: @active),
          mavlink_version: 3
        }

      _silent ->
        Store.count(gateway, {:identity, :held})
        :held
    end
  end

  @doc "Whether the caller is the one to send it by a path now: nobody else did, and nobody withholds it there."
  @spec claim(Names.gateway(), Endpoint.key()) :: boolean
  def claim(gateway, path) do
    not Store.claimed?(gateway, {:withheld, path}, @withheld_ms) and
      Store.claim(gateway, {:heartbeat, path}, @claimed_ms)
  end

  @doc """
  Keeps it off a path for the next #{div(@withheld_ms, 1_000)} s, because a vehicle there would take it for its
  operator's. Other vehicles on that path do not get it either, since everything on a path is heard by all of them.
  """
  @spec withhold(Names.gateway(), Endpoint.key()) :: :ok
  def withhold(gateway, path) do
    Store.claim(gateway, {:withheld, path}, 1)
    Store.count(gateway, {:identity, :withheld})
    :ok
  end
end
