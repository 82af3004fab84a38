defmodule Aerie.Fleet.Nats.JetStream do
  @moduledoc "What JetStream is asked for beside its streams (`Gnat.Jetstream.API.Stream`), as requests."

  alias Aerie.Fleet.Nats

  @timeout_ms 5_000
  @wrong_sequence 10_071
  @no_message 10_037

  @typedoc "A stored message; `headers` is their text."
  @type stored :: %{seq: pos_integer(), subject: String.t(), headers: binary(), body: binary()}

  @doc "The shortest window in which a stream may look for copies (`Nats-Msg-Id`), in nanoseconds: for messages that have no ids."
  @spec no_window() :: pos_integer()
  def no_window, do: 100_000_000

  @doc "Asks the API or a stream: the answer's object, or an error, which is a map if JetStream answered one. `timeout` (ms), `headers`."
  @spec ask(Nats.conn(), String.t(), iodata(), timeout: pos_integer(), headers: Nats.headers()) ::
          {:ok, map()} | {:error, Nats.reason()}
  def ask(conn, subject, body, options \\ []) do
    {timeout, options} = Keyword.pop(options, :timeout, @timeout_ms)

    with {:ok, %{body: answer}} <- Nats.request(conn, subject, body, [receive_timeout: timeout] ++ options) do
      case answer |> IO.iodata_to_binary() |> JSON.decode() do
        {:ok, %{"error" => error}} -> {:error, error}
        {:ok, %{} = object} -> {:ok, object}
        _other -> {:error, "an answer that is not understood"}
      end
    end
  end

  @doc """
  Publishes, and waits until the stream has the message. With `expected` only if the last message of this subject has this number,
  0 for none. `timeout` (ms), `headers`.
  """
  @spec publish(Nats.conn(), String.t(), iodata(),
          expected: non_neg_integer(),
          timeout: pos_integer(),
          headers: Nats.headers()
        ) :: :ok | :lost_race | {:error, Nats.reason()}
  def publish(conn, subject, body, options \\ []) do
    {expected, options} = Keyword.pop(options, :expected)
    header = if expected, do: [{"Nats-Expected-Last-Subject-Sequence", "#{expected}"}], else: []

    case ask(conn, subject, body, Keyword.update(options, :headers, header, &(header ++ &1))) do
      {:ok, %{"seq" => _stored}} -> :ok
      {:ok, _other} -> {:error, "an answer that is not understood"}
      {:error, %{"err_code" => @wrong_sequence}} -> :lost_race
      error -> error
    end
  end

  @doc ~S(Reads a stored message, by an object of the API such as `%{"last_by_subj" => subject}`.)
  @spec stored(Nats.conn(), stream :: String.t(), map(), timeout: pos_integer()) ::
          {:ok, stored()} | :none | {:error, Nats.reason()}
  def stored(conn, stream, which, options \\ []) do
    case ask(conn, "$JS.API.STREAM.MSG.GET.#{stream}", JSON.encode!(which), options) do
      {:ok, %{"message" => %{"seq" => seq, "subject" => subject} = message}} ->
        {:ok, %{seq: seq, subject: subject, headers: bytes(message["hdrs"]), body: bytes(message["data"])}}

      {:ok, _other} ->
        {:error, "an answer that is not understood"}

      {:error, %{"err_code" => @no_message}} ->
        :none

      error ->
        error
    end
  end

  defp bytes(text) do
    with true <- is_binary(text), {:ok, bytes} <- Base.decode64(text), do: bytes, else: (_none -> "")
  end

  @doc "A header of a stored message, nil if it has none of this name."
  @spec header(stored(), String.t()) :: String.t() | nil
  def header(%{headers: headers}, name) do
    case Regex.run(~r/^#{name}:\s*(.*?)\r?$/im, headers) do
      [_, value] when is_binary(value) -> value
      nil -> nil
    end
  end
end
