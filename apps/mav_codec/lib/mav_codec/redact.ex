defmodule MavCodec.Redact do
  @moduledoc """
  Takes secrets out of frames before they are written to a log (S9).

  SETUP_SIGNING contains the link's key: its 32 bytes become 0xFF, and the frame loses its signature, which no longer fits. Other
  frames stay unchanged, or lose their signatures on request. Damaged or unusual SETUP_SIGNING frames (surplus bytes,
  truncated keys) are redacted too.
  """

  alias MavCodec.{Frame, Raw, Signing}

  @setup_signing 256
  # On the wire: initial_timestamp (8), target_system, target_component, secret_key (32).
  @before_key 10
  @key 32

  @doc "`frame` without secrets; with `signatures: false` without its signature too."
  @spec frame(Frame.t(), [{:signatures, boolean()}]) :: Frame.t()
  def frame(frame, options \\ [])
  def frame(%Frame{id: @setup_signing} = frame, _options), do: without_key(frame)

  def frame(frame, options),
    do: if(Keyword.get(options, :signatures, true), do: frame, else: Signing.strip(frame))

  defp without_key(%Frame{} = frame) do
    missing = max(@before_key - byte_size(frame.payload), 0)
    head = binary_part(frame.payload, 0, min(@before_key, byte_size(frame.payload)))
    payload = head <> <<0::size(missing)-unit(8)>> <> :binary.copy(<<0xFF>>, @key)

    # The id is not in the dialect: the CRC could not be checked before either.
    extra = frame.crc_extra || 0

    Raw.frame(@setup_signing, payload, extra,
      system: frame.system,
      component: frame.component,
      seq: frame.seq,
      compat_flags: frame.compat,
      target_system: frame.target_system,
      sysid32: true
    )
    |> Frame.from_bytes(frame.crc_extra, frame.at)
  end
end
