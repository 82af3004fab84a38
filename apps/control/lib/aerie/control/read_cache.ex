defmodule Aerie.Control.ReadCache do
  @moduledoc """
  Answers ground stations that read parameters, by messages or as ArduPilot's file, and plans from the gateway's copy, while that copy is known to be right
  (`Aerie.Control.Params.Responder`, `Protocols.Mission.Responder`). So the vehicle is read once for any number of stations. Other requests go to the
  vehicle. The client's rule `served` turns this on.
  """

  @behaviour MavRouter.Sharing.ReadCache

  alias Aerie.Base.Names
  alias MavCodec.Messages, as: M

  @params [M.ParamRequestList, M.ParamRequestRead, M.ParamSet]
  @plans [M.MissionRequestList, M.MissionRequestInt, M.MissionRequest, M.MissionAck, M.MissionCount] ++
           [M.MissionItem, M.MissionItemInt, M.MissionClearAll, M.MissionWritePartialList]
  @files [M.FileTransferProtocol]
  @ids Enum.map(@params ++ @plans ++ @files, & &1.id())
  @call_ms 1_000

  @doc "The kind of data that a message requests."
  @spec about(struct()) :: :params | :plans | :files
  def about(%module{}) when module in @params, do: :params
  def about(%module{}) when module in @files, do: :files
  def about(_message), do: :plans

  @impl MavRouter.Sharing.ReadCache
  def reading?(%{id: id}), do: id in @ids

  @impl MavRouter.Sharing.ReadCache
  def take(gateway, vehicle, endpoint, frame) do
    with pid when pid != nil <- Names.whereis(gateway, :read_cache, vehicle),
         {:ok, message} <- MavCodec.decode(frame) do
      # A waiting frame must not keep the whole read in memory.
      frame = %{frame | bytes: :binary.copy(frame.bytes), payload: :binary.copy(frame.payload)}
      GenServer.call(pid, {:station, endpoint, frame, message}, @call_ms)
    else
      _none -> :forward
    end
  catch
    :exit, _busy_or_gone -> :forward
  end
end
