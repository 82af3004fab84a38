defmodule Aerie.Control.TransferExecutor.Job do
  @moduledoc """
  One transfer with a vehicle, as it is given to `Aerie.Control.TransferExecutor`: the machine that carries it out,
  and what it needs for itself meanwhile.

  A machine is a module with `handle(machine, event) -> {machine, actions}` and `wake_at(machine)`, as `Aerie.Control.Params.Fetch.Download`
  describes them; its end is `{:done, result}`, or `{:result, result}` of `Protocols.Mission.Transfer`. One that uses
  files also has `seq(machine)`, the number that the next one begins with.
  """

  alias MavRouter.Sharing.TransferLock

  @enforce_keys [:id, :lanes, :start, :until]
  defstruct [:id, :lanes, :start, :until, :share, :machine, :start_by] ++
              [yields: false, phase: :queued, turns: [], asked: []]

  @typedoc """
  What only one transfer at a time may use: PARAM and PARAM_EXT messages, the mission protocol (missions, fences and
  rally points together, as in PX4), MAVLink FTP, and LOG messages.
  """
  @type lane :: :params | :mission | :file | :log

  @typedoc """
  What a machine is made of when its turn has come: ids of the vehicle's autopilot and of the gateway, the version of
  MAVLink, the adapter of the firmware, MAV_PROTOCOL_CAPABILITY bits (nil: not known), the measured round trip (nil:
  not measured), the number of the next FTP request, and the time.
  """
  @type context :: %{
          target: {non_neg_integer(), 0..255},
          us: {non_neg_integer(), 0..255},
          version: 1 | 2,
          protocol: module(),
          autopilot: Aerie.Vehicle.Firmware.name(),
          capabilities: non_neg_integer() | nil,
          rtt_us: non_neg_integer() | nil,
          links: [term()],
          ftp?: boolean(),
          seq: 0..65_535,
          now: integer()
        }

  @typedoc """
    * `:start` - makes the machine; an error is the end of the transfer
    * `:until` - its deadline in microseconds of `System.monotonic_time/1`; nothing is sent from then on
    * `:share` - transfers with the same term (not nil) are one: callers that come while it is under way get its result
    * `:yields` - its caller may not change the vehicle, so it ends (`{:error, :yielded}`) when anything else
      wants its lane, or a ground station its turn
    * the others are the state of it: the machine, when it has to have begun, and which turns it has and waits for
  """
  @type t :: %__MODULE__{
          id: String.t(),
          lanes: [lane(), ...],
          start: (context() -> {:ok, struct()} | {:error, term()}),
          until: integer(),
          share: term(),
          yields: boolean(),
          machine: struct() | nil,
          start_by: integer() | nil,
          phase: :queued | :turn | :running,
          turns: [TransferLock.kind()],
          asked: [TransferLock.kind()]
        }

  @doc "The turns that it needs among the transfers of ground stations (`MavRouter.Sharing.TransferLock`)."
  @spec kinds(t()) :: [TransferLock.kind()]
  def kinds(job), do: for(lane <- job.lanes, lane in TransferLock.kinds(), do: lane)
end
