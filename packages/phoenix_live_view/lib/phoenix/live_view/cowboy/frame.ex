defmodule Phoenix.LiveView.Cowboy.Frame do
  @moduledoc "Messages of the WebSocket: JSON arrays `[join_ref, ref, topic, event, payload]`."

  @type t ::
          {join_ref :: String.t() | nil, ref :: String.t() | nil, topic :: String.t(), event :: String.t(),
           payload :: map()}

  @doc "Reads a frame of the client. Total."
  @spec decode(binary()) :: {:ok, t()} | :error
  def decode(text) do
    case JSON.decode(text) do
      {:ok, [join_ref, ref, topic, event, payload]}
      when (is_binary(join_ref) or is_nil(join_ref)) and (is_binary(ref) or is_nil(ref)) and is_binary(topic) and
             is_binary(event) and is_map(payload) ->
        {:ok, {join_ref, ref, topic, event, payload}}

      _other ->
        :error
    end
  end

  @doc "Encodes a frame for the client."
  @spec encode(String.t() | nil, String.t() | nil, String.t(), String.t(), map()) :: iodata()
  def encode(join_ref, ref, topic, event, payload),
    do: JSON.encode_to_iodata!([join_ref, ref, topic, event, payload])
end
