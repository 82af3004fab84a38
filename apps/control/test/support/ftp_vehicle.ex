defmodule Aerie.FtpVehicle do
  @moduledoc "The simulated vehicles' FTP server and logs as a model for `Aerie.LossyLink`."

  alias MavCodec.Messages, as: M
  alias SimVehicle.{Ftp, Params}
  alias SimVehicle.Vehicle.Logs

  defstruct [:ftp, :logs, params: %Params{}, asked: 0]

  @doc "With files by path; `logs`, `params` as the simulator has them."
  def new(style, files \\ %{}, more \\ []) do
    params = Keyword.get(more, :params) || Params.new([{"A", 1, 4}], :c_cast)

    %__MODULE__{
      ftp: Ftp.new(style, files),
      logs: Logs.new(style, Keyword.get(more, :logs, [])),
      params: params
    }
  end

  def file(vehicle, path), do: vehicle.ftp.files[path]
  def reboot(vehicle), do: %{vehicle | ftp: Ftp.reboot(vehicle.ftp), logs: Logs.reboot(vehicle.logs)}

  @doc "For `Aerie.LossyLink.run/5`."
  def answer(v, %M.FileTransferProtocol{payload: payload}, _now) do
    {ftp, answers} = Ftp.handle(v.ftp, payload, :us, v.params)

    {%{v | ftp: ftp, asked: v.asked + 1},
     for({at, payload} <- answers, do: {at, %M.FileTransferProtocol{payload: payload}})}
  end

  # All that a request brings, at once: a new request does not stop it here, which is worse than what vehicles do.
  def answer(v, message, _now) do
    {logs, said} = Logs.handle(v.logs, message)
    {logs, pieces} = all(logs, [])
    {%{v | logs: logs, asked: v.asked + 1}, for({m, n} <- Enum.with_index(said ++ pieces), do: {n * 500, m})}
  end

  defp all(logs, sent) do
    case Logs.tick(logs) do
      {%{sending: nil} = logs, pieces} -> {logs, sent ++ pieces}
      {logs, pieces} -> all(logs, sent ++ pieces)
    end
  end
end
