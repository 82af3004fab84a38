defmodule Aerie.Bridge.Forward.Local do
  @moduledoc "Reads the local stream of events for `Aerie.Bridge.Forward`."

  alias Aerie.Bridge.Events.Gaps
  alias Aerie.Bridge.Outbox.Record
  alias Gnat.Jetstream.API.Stream

  @stream "FLEET_EVENTS"
  @timeout_ms 2_000

  @typedoc "`late?`: it was marked as back-filled when the local stream got it."
  @type message :: %{seq: pos_integer(), record: Record.t(), place: Gaps.place() | nil, late?: boolean()}

  @doc "The first message from `seq` on; `:none` if there is none yet."
  @spec next(Gnat.t(), pos_integer()) :: {:ok, message()} | :none | {:error, term()}
  def next(conn, seq) do
    request = JSON.encode!(%{"seq" => seq, "next_by_subj" => ">"})

    with {:ok, %{body: body}} <-
           Gnat.request(conn, "$JS.API.STREAM.MSG.GET.#{@stream}", request, receive_timeout: @timeout_ms) do
      case JSON.decode(body) do
        {:ok, %{"message" => %{"seq" => seq, "subject" => subject} = message}} ->
          {:ok, message(seq, subject, message)}

        {:ok, %{"error" => %{"code" => 404}}} ->
          :none

        _error ->
          {:error, :no_answer}
      end
    end
  end

  defp message(seq, subject, message) do
    body = bytes(message["data"])
    head = bytes(message["hdrs"])

    object =
      case JSON.decode(body) do
        {:ok, %{} = object} -> object
        _other -> %{}
      end

    # A message of somebody else on this subject has an id of the stream's.
    id = header(head, "Nats-Msg-Id") || "#{subject}-#{seq}"
    vehicle = subject |> String.split(".") |> Enum.at(2)

    %{
      seq: seq,
      record: %Record{id: id, vehicle: vehicle, subject: subject, body: body},
      place: Gaps.place(object),
      late?: header(head, "Aerie-Backfill") == "true"
    }
  end

  defp header(head, name) do
    with [_, value] <- Regex.run(~r/^#{name}:\s*(.*?)\r?$/im, head), do: value
  end

  defp bytes(text) when is_binary(text) do
    case Base.decode64(text) do
      {:ok, bytes} -> bytes
      :error -> ""
    end
  end

  defp bytes(_none), do: ""

  @doc "When the stream was made, and its last message."
  @spec info(Gnat.t()) :: {:ok, born :: String.t(), last :: non_neg_integer()} | {:error, term()}
  def info(conn) do
    with {:ok, %{created: created, state: state}} <- Stream.info(conn, @stream),
         do: {:ok, to_string(created), state.last_seq}
  end
end
