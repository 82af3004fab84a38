defmodule Aerie.Vehicle.Firmware.Ardupilot.Steering do
  @moduledoc """
  Whether ArduPilot will obey sticks and set-points, which it acknowledges by nothing.

  Overrides and joysticks count of the ground station only whose system id is MAV_GCS_SYSID (to MAV_GCS_SYSID_HI; SYSID_MYGCS before 4.7), and
  only while RC_OVERRIDE_TIME is not 0 and RC_OPTIONS does not say otherwise (`GCS_MAVLINK::handle_rc_channels_override`,
  `RC_Channel::has_override`). Set-points count in GUIDED only (`Mode::in_guided_mode`).
  """

  import Bitwise

  alias Aerie.Vehicle.Protocol.Vehicle

  @ignore_overrides 2

  @doc "Whether it obeys our sticks: an error says why not, a note what is not known."
  @spec sticks(Vehicle.t()) :: {:ok, note :: String.t() | nil} | {:error, String.t()}
  def sticks(%{gcs: range, params: params, us: {system, _component}}) do
    cond do
      params["RC_OVERRIDE_TIME"] in [0, 0.0] ->
        {:error, "its parameter RC_OVERRIDE_TIME is 0, so it takes no overrides"}

      (trunc(params["RC_OPTIONS"] || 0) &&& @ignore_overrides) != 0 ->
        {:error, "its parameter RC_OPTIONS says that it takes no overrides"}

      range == nil ->
        {:ok,
         "whether it obeys this gateway is not known: its parameter MAV_GCS_SYSID (SYSID_MYGCS before 4.7) was not read yet"}

      system in elem(range, 0)..elem(range, 1)//1 ->
        {:ok, nil}

      true ->
        {:error,
         "it obeys #{listened(range)} only (MAV_GCS_SYSID, SYSID_MYGCS before 4.7), and this gateway is system #{system} (mavlink.system_id)"}
    end
  end

  defp listened({system, system}), do: "the ground station with the system id #{system}"
  defp listened({low, high}), do: "ground stations with system ids from #{low} to #{high}"

  @doc "Whether it obeys a set-point in its mode; an error says why not."
  @spec setpoint(type :: String.t(), Vehicle.t()) :: :ok | {:error, String.t()}
  def setpoint("setpoint_attitude", %{mode: "GUIDED_NOGPS"}), do: :ok
  def setpoint(_type, %{mode: mode}) when mode in [nil, "GUIDED"], do: :ok

  def setpoint(_type, %{mode: mode}),
    do: {:error, "it is in #{mode}, and obeys set-points in GUIDED only: set_mode GUIDED first"}

  @doc "The lasting reason why it does not obey a set-point; nil for none."
  @spec note(Vehicle.t()) :: String.t() | nil
  def note(vehicle) do
    if vehicle.in_air == false and Vehicle.flies?(vehicle),
      do: "it is on the ground, and obeys set-points only when it has taken off"
  end
end
