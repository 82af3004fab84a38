defmodule MavCodec.Tlog do
  @moduledoc """
  Recordings in the format of ground stations (G1): before each frame its time, unix microseconds in 8 bytes, big-endian.
  `MavCodec.Tlog.Reader` reads them.
  """

  alias MavCodec.Frame
  alias MavCodec.Signing.Redact

  @doc """
  The records of `frames` as iodata; a frame without a time of arrival gets that of the call. Keys of signed links are
  never in them (S9, `MavCodec.Signing.Redact`). `signatures: false` leaves the signatures of signed frames out.
  """
  @spec records([Frame.t()], [{:signatures, boolean()}]) :: iodata()
  def records(frames, options \\ []) do
    for frame <- frames do
      [<<frame.at || System.os_time(:microsecond)::64>>, Redact.frame(frame, options).bytes]
    end
  end
end
