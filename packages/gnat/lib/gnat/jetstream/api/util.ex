defmodule Gnat.Jetstream.API.Util do
  @moduledoc "Requests to the JetStream API, answers as JSON, names, times."

  alias Gnat.Error

  @typedoc """
  An error of the JetStream API: `"code"` like HTTP, `"err_code"` for the exact reason, `"description"`.
  """
  @type api_error :: %{String.t() => term()}

  @doc "Sends a request to the API and reads the answer, which may be an error."
  @spec request(Gnat.t(), String.t(), iodata(), keyword()) ::
          {:ok, map()} | {:error, api_error() | :timeout | :no_responders | Error.t()}
  def request(conn, topic, payload, opts \\ []) do
    opts = Keyword.put_new_lazy(opts, :receive_timeout, &Gnat.answer_ms/0)
    with {:ok, %{body: body}} <- Gnat.request(conn, topic, payload, opts), do: answer(body)
  end

  @doc "Reads an answer of the API or the acknowledgement of a publish."
  @spec answer(binary()) :: {:ok, map()} | {:error, api_error() | Error.t()}
  def answer(body) do
    case JSON.decode(body) do
      {:ok, %{"error" => error}} -> {:error, error}
      {:ok, %{} = answer} -> {:ok, answer}
      _other -> {:error, Error.new({:protocol, "JetStream's answer is not a JSON object"})}
    end
  end

  @doc "A struct or map as JSON for the API, without fields that are nil, because the server refuses unknown fields."
  @spec encode(map()) :: iodata()
  def encode(map), do: map |> Map.reject(fn {_key, value} -> value == nil end) |> JSON.encode_to_iodata!()

  @doc "A point in time as the server writes it (RFC 3339); nil for anything else."
  @spec to_datetime(term()) :: DateTime.t() | nil
  def to_datetime(text) when is_binary(text) do
    case DateTime.from_iso8601(text) do
      {:ok, datetime, _offset} -> datetime
      {:error, _} -> nil
    end
  end

  def to_datetime(_none), do: nil

  @doc "The known atom for this text, or the text itself, which a newer server may send."
  @spec to_atom(term(), [atom()]) :: atom() | term()
  def to_atom(text, known), do: Enum.find(known, text, &(Atom.to_string(&1) == text))

  @doc "Decodes base 64; nil for anything else."
  @spec decode_base64(term()) :: binary() | nil
  def decode_base64(text) when is_binary(text) do
    case Base.decode64(text) do
      {:ok, bytes} -> bytes
      :error -> nil
    end
  end

  def decode_base64(_none), do: nil

  @doc "Whether a stream, consumer or bucket can have this name."
  @spec check_name(term(), String.t()) :: :ok | {:error, String.t()}
  def check_name(name, what) do
    cond do
      not is_binary(name) -> {:error, "#{what} must be a string"}
      name == "" -> {:error, "#{what} must not be empty"}
      String.contains?(name, [".", "*", ">", "/", "\\", " ", "\t", "\r", "\n"]) -> {:error, bad_name(what)}
      true -> :ok
    end
  end

  defp bad_name(what), do: "invalid #{what}: cannot contain '.', '>', '*', '/', '\\' or blanks"
end
