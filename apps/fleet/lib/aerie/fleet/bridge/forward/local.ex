defmodule Aerie.Fleet.Bridge.Forward.Local do
  @moduledoc "Reads the local stream of events for `Aerie.Fleet.Bridge.Forward`."

  alias Aerie.Fleet.Bridge.Events.Gaps
  alias Aerie.Fleet.Bridge.Events.Outbox.Record
  alias Aerie.Fleet.Nats
  alias Aerie.Fleet.Nats.JetStream
  alias Gnat.Jetstream.API.Stream

  @stream "FLEET_EVENTS"
  @timeout_ms 2_000

  @typedoc "`late?`: it was marked as back-filled when the local stream got it."
  @type message :: %{seq: pos_integer(), record: Record.t(), place: Gaps.place() | nil, late?: boolean()}

  @doc "The first message from `seq` on; `:none` if there is none yet."
  @spec next(Aerie.Fleet.Nats.conn(), pos_integer()) :: {:ok, message()} | :none | {:error, term()}
  def next(conn, seq) do
    case JetStream.stored(conn, @stream, %{"seq" => seq, "next_by_subj" => ">"}, timeout: @timeout_ms) do
      {:ok, stored} -> {:ok, message(stored)}
      none_or_error -> none_or_error
    end
  end

  defp message(%{seq: seq, subject: subject, body: body} = stored) do
    object =
      case JSON.decode(body) do
        {:ok, %{} = object} -> object
        _other -> %{}
      end

    # A message of somebody else on this subject has an id of the stream's.
    id = JetStream.header(stored, "Nats-Msg-Id") || "#{subject}-#{seq}"
    vehicle = subject |> String.split(".") |> Enum.at(2)

    %{
      seq: seq,
      record: %Record{id: id, vehicle: vehicle, subject: subject, body: body},
      place: Gaps.place(object),
      late?: JetStream.header(stored, "Aerie-Backfill") == "true"
    }
  end

  @doc "When the stream was made, and its last message."
  @spec info(Aerie.Fleet.Nats.conn()) ::
          {:ok, born :: String.t(), last :: non_neg_integer()} | {:error, term()}
  def info(conn) do
    with {:ok, %{created: created, state: state}} <- Nats.call(conn, fn -> Stream.info(conn, @stream) end),
         do: {:ok, to_string(created), state.last_seq}
  end
end
