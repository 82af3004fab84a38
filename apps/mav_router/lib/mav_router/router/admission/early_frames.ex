defmodule MavRouter.Router.Admission.EarlyFrames do
  @max_reads 128
  @max_kept 16_384
  # Frames of one read: many times those of a datagram or of a radio's read.
  @max_frames 16

  @moduledoc """
  Frames of vehicles whose sessions are being started (`MavRouter.Router.Admission`), in the order in which they came, for those to take.

  A row in the table `waiting` is the gate: the process that takes the row collects the frames. A process that keeps more writes first and looks
  for the row afterwards. If it is there, it will be taken later, and what was written will be found. If it is gone, the writer takes
  back what it wrote, unless it was collected in between. So each frame arrives once, whichever process is faster.

  The frames of at most #{@max_reads} reads of a vehicle are kept besides those of the read in which it was found, #{@max_frames} of a read, and
  those of #{@max_kept} reads together: 64 MiB if all are as long as can be.
  """

  alias MavRouter.Tables
  alias MavCodec.Frame

  @type key :: {network :: String.t(), system :: non_neg_integer}

  @doc "Puts the frames by which a vehicle was found."
  @spec put(Tables.t(), key, [Frame.t()]) :: :ok
  def put(tables, key, frames) do
    _ = write(tables, key, frames)
    :ok
  end

  @doc "Keeps further frames, `:none` when there is no room or the gate is shut."
  @spec keep(Tables.t(), key, [Frame.t()]) :: :kept | :none
  def keep(tables, key, frames) do
    if length(frames) <= @max_frames and room?(tables, key),
      do: tables |> write(key, Enum.map(frames, &own/1)) |> checked(tables, key),
      else: :none
  end

  # A frame refers to all that was read with it, up to 64 KiB.
  defp own(frame),
    do: %{frame | bytes: :binary.copy(frame.bytes), payload: :binary.copy(frame.payload)}

  # The key of the frames by number, and the numbers of all that the vehicle has, are one range of the table.
  defp room?(tables, key) do
    :ets.info(tables.early, :size) < @max_kept and
      :ets.select_count(tables.early, [{{{key, :_}, :_}, [], [true]}]) < @max_reads
  end

  defp write(tables, key, frames) do
    row = {key, :erlang.unique_integer([:monotonic])}
    true = :ets.insert(tables.early, {row, frames})
    row
  end

  defp checked(row, tables, key) do
    cond do
      :ets.member(tables.waiting, key) -> :kept
      :ets.take(tables.early, row) == [] -> :kept
      true -> :none
    end
  end

  @doc "Takes them all, the oldest first; called after the row of `waiting` was taken."
  @spec take(Tables.t(), key) :: [Frame.t()]
  def take(tables, key) do
    for number <- :ets.select(tables.early, [{{{key, :"$1"}, :_}, [], [:"$1"]}]),
        {_row, frames} <- :ets.take(tables.early, {key, number}),
        frame <- frames,
        do: frame
  end
end
