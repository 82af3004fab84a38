defmodule MavCodec.Signing.Redact do
  @moduledoc """
  The messages that carry passwords and keys, and frames without them (S9): the one list, by which routers keep them
  from others and recordings leave them out.

  The bytes of a key become 0xFF, a text becomes stars, and the frame loses its signature, which no longer fits. Other
  frames stay unchanged, or lose their signatures on request. Damaged or unusual frames (surplus bytes, a secret that
  is cut off) are redacted as well.

  A value of PARAM_EXT is secret if the name of its parameter says so (`PASS`, `PSK`, `PWD`, `SECRET`), the address of
  a video stream if it has a user name or a password. Such addresses and the replies to SECURE_COMMAND are of use to
  those who ask for them, so routers pass them on; no recording has them.
  """

  alias MavCodec.{Frame, Signing}
  alias MavCodec.Frame.Raw

  # id => name, bytes of a whole payload, secrets on the wire, what says that they are (nil: they always are), whether
  # routers keep it from clients. A test compares it with the definitions.
  @rows %{
    5 => {"CHANGE_OPERATOR_CONTROL", 28, [{3, 25, :text}], nil, true},
    7 => {"AUTH_KEY", 32, [{0, 32, :text}], nil, true},
    256 => {"SETUP_SIGNING", 42, [{10, 32, :key}], nil, true},
    269 => {"VIDEO_STREAM_INFORMATION", 215, [{53, 160, :text}], {:login, 53, 160}, false},
    299 => {"WIFI_CONFIG_AP", 98, [{32, 64, :text}], nil, true},
    322 => {"PARAM_EXT_VALUE", 149, [{20, 128, :text}], {:name, 4, 16}, true},
    323 => {"PARAM_EXT_SET", 147, [{18, 128, :text}], {:name, 2, 16}, true},
    324 => {"PARAM_EXT_ACK", 146, [{16, 128, :text}], {:name, 0, 16}, true},
    336 => {"CELLULAR_CONFIG", 84, [{2, 16, :text}, {18, 16, :text}, {66, 16, :text}], nil, true},
    11_004 => {"SECURE_COMMAND", 232, [{12, 220, :key}], nil, true},
    11_005 => {"SECURE_COMMAND_REPLY", 230, [{10, 220, :key}], nil, false},
    52_000 => {"AIRLINK_AUTH", 100, [{0, 50, :text}, {50, 50, :text}], nil, true}
  }
  @words ~w(PASS PSK PWD SECRET)

  @type span :: {offset :: non_neg_integer(), bytes :: pos_integer(), :text | :key}

  @doc "The messages with their bytes that are secret, and whether routers keep them from clients."
  @spec table() :: [{id :: non_neg_integer(), name :: String.t(), [span(), ...], kept? :: boolean()}]
  def table, do: for({id, {name, _bytes, spans, _by, kept?}} <- @rows, do: {id, name, spans, kept?})

  @doc "Whether a frame carries a secret."
  @spec secret?(Frame.t()) :: boolean()
  def secret?(%{id: id} = frame) when is_map_key(@rows, id), do: secret?(frame, elem(@rows[id], 3))
  def secret?(_other), do: false

  @doc "Whether a frame carries a secret that is for the vehicle that it is sent to, and for nobody else."
  @spec kept?(Frame.t()) :: boolean()
  def kept?(%{id: id} = frame) when is_map_key(@rows, id), do: elem(@rows[id], 4) and secret?(frame)
  def kept?(_other), do: false

  defp secret?(_frame, nil), do: true

  defp secret?(frame, {:name, at, bytes}),
    do: frame |> part(at, bytes) |> String.upcase(:ascii) |> String.contains?(@words)

  defp secret?(frame, {:login, at, bytes}), do: frame |> part(at, bytes) |> String.contains?("@")

  defp part(frame, at, bytes), do: frame |> whole(at + bytes) |> binary_part(at, bytes)

  # Bytes that a sender cut off are zero.
  defp whole(%{payload: payload}, bytes) do
    missing = max(bytes - byte_size(payload), 0)
    binary_part(payload <> <<0::size(missing)-unit(8)>>, 0, bytes)
  end

  @doc "`frame` without secrets; with `signatures: false` without its signature too."
  @spec frame(Frame.t(), [{:signatures, boolean()}]) :: Frame.t()
  def frame(frame, options \\ []) do
    cond do
      secret?(frame) -> without(frame, @rows[frame.id])
      Keyword.get(options, :signatures, true) -> frame
      true -> Signing.strip(frame)
    end
  end

  defp without(%Frame{} = frame, {_name, bytes, spans, _by, _kept?}) do
    payload = Enum.reduce(spans, whole(frame, bytes), &hide/2)

    # The id is not in the dialect: the CRC could not be checked before either.
    extra = frame.crc_extra || 0

    Raw.frame(frame.id, payload, extra,
      system: frame.system,
      component: frame.component,
      seq: frame.seq,
      compat_flags: frame.compat,
      target_system: frame.target_system,
      sysid32: true
    )
    |> Frame.from_bytes(frame.crc_extra, frame.at)
  end

  defp hide({at, length, kind}, payload) do
    <<before::binary-size(^at), _secret::binary-size(^length), rest::binary>> = payload
    before <> hidden(kind, length) <> rest
  end

  defp hidden(:key, length), do: :binary.copy(<<0xFF>>, length)
  defp hidden(:text, length), do: binary_part("********" <> <<0::size(length)-unit(8)>>, 0, length)
end
