defmodule Aerie.Vehicle.Streams do
  @moduledoc """
  Asks a vehicle for the state messages that it does not send by itself. A pure value.

  Rates belong to the link, not to who asked (M2), and other programs ask too; so this asks as little as can be: only for
  messages that do not come, two seconds after the vehicle was first seen, after a reboot (R6) or an interruption of its
  link, or when one that came has
  stopped for ten seconds while the vehicle is heard (M3). SET_MESSAGE_INTERVAL comes first; what is still missing three
  and ten seconds later is asked for again, and a vehicle that obeys neither gets one REQUEST_DATA_STREAM. Then it is left
  alone until the next reboot, or for a minute.

  What comes is not asked for, however slow or fast it is.
  """

  alias MavCodec.Messages.{CommandLong, RequestDataStream}

  @set_message_interval 511
  @request_message 512

  # Message id => interval asked for, us.
  @streams %{
    245 => 500_000,
    33 => 250_000,
    30 => 250_000,
    74 => 500_000,
    1 => 1_000_000,
    24 => 1_000_000,
    147 => 2_000_000,
    42 => 1_000_000,
    65 => 1_000_000
  }
  # What comes once when asked for. HOME_POSITION comes by itself when it changes.
  @once [148, 242]

  @grace_us 2_000_000
  @retries_us [3_000_000, 10_000_000]
  @stopped_us 10_000_000
  @quiet_us 60_000_000
  @all_streams 0
  @fall_back_hz 4

  defstruct [:due, round: 0, asked: 0, heard: %{}]

  @type t :: %__MODULE__{
          due: integer() | nil,
          round: non_neg_integer(),
          heard: %{non_neg_integer() => integer()}
        }

  @doc "Nothing seen yet."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc "A message of the autopilot came."
  @spec heard(t(), non_neg_integer(), integer()) :: t()
  def heard(%{due: nil} = streams, id, at), do: heard(%{streams | due: at + @grace_us}, id, at)

  def heard(streams, id, at) when is_map_key(@streams, id) or id in @once do
    %{streams | heard: Map.put(streams.heard, id, at)}
  end

  def heard(streams, _id, _at), do: streams

  @doc "The vehicle was restarted, or its link was interrupted: its streams are what it begins with."
  @spec rebooted(t(), integer()) :: t()
  def rebooted(_streams, at), do: %__MODULE__{due: at + @grace_us}

  @doc "Time goes on from `now`: what was heard counts as heard now."
  @spec rebased(t(), integer()) :: t()
  def rebased(streams, now) do
    heard = Map.new(streams.heard, fn {id, _at} -> {id, now} end)
    %{streams | due: streams.due && now + @grace_us, asked: min(streams.asked, now), heard: heard}
  end

  @doc "What to send at `now` to a vehicle that is being heard; mostly nothing."
  @spec expire(t(), integer(), target :: {non_neg_integer(), non_neg_integer()}) :: {t(), [struct()]}
  def expire(%{due: due} = streams, now, _target) when due == nil or now < due, do: {streams, []}

  def expire(streams, now, target) do
    missing = for {id, interval} <- Enum.sort(@streams), missing?(streams, id, now), do: {id, interval}
    unknown = for id <- @once, not is_map_key(streams.heard, id), do: id
    ask(streams, now, target, missing, unknown)
  end

  defp missing?(streams, id, now) do
    case streams.heard do
      %{^id => at} -> now - at > @stopped_us
      _never -> true
    end
  end

  defp ask(streams, now, _target, [], []), do: {%{streams | round: 0, due: now + @stopped_us}, []}

  defp ask(%{round: round} = streams, now, target, missing, unknown) when round <= length(@retries_us) do
    messages =
      Enum.map(missing, fn {id, interval} -> command(target, @set_message_interval, id, interval) end) ++
        Enum.map(unknown, &command(target, @request_message, &1, 0))

    # Who has obeyed none of the commands may know only the old way.
    fall_back =
      if round == length(@retries_us) and length(missing) > div(map_size(@streams), 2),
        do: [all(target)],
        else: []

    wait = Enum.at(@retries_us, round, @quiet_us)
    {%{streams | round: round + 1, asked: now, due: now + wait}, messages ++ fall_back}
  end

  # Asked often enough: what is missing is not there. Only what came since and stopped is worth asking for again.
  defp ask(streams, now, target, missing, unknown) do
    stopped = for {id, _interval} <- missing, Map.get(streams.heard, id, 0) > streams.asked, do: id

    if stopped == [],
      do: {%{streams | due: now + @stopped_us}, []},
      else: ask(%{streams | round: 0}, now, target, missing, unknown)
  end

  defp command({system, component}, command, param1, param2) do
    %CommandLong{
      target_system: system,
      target_component: component,
      command: command,
      param1: param1 * 1.0,
      param2: param2 * 1.0
    }
  end

  defp all({system, component}) do
    %RequestDataStream{
      target_system: system,
      target_component: component,
      req_stream_id: @all_streams,
      req_message_rate: @fall_back_hz,
      start_stop: 1
    }
  end
end
