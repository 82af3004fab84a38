defmodule Aerie.ParamsCamera do
  @moduledoc "`SimVehicle.Vehicle.Camera` for `Aerie.LossyLink`, which has no ticks: what it works on is done when it is next asked."

  alias SimVehicle.Vehicle.Camera

  @doc "A camera that sends no heartbeats."
  def new, do: %{Camera.new(100) | beat_at: 1_000_000_000_000}

  @doc "For `Aerie.LossyLink.run/5`."
  def answer(camera, message, now) do
    {camera, _sent_already} = Camera.tick(camera, now)

    case Camera.handle(camera, message, now) do
      {%{work: {_name, _value, at} = work} = busy, answers} when work != camera.work ->
        {_done, [ack]} = Camera.tick(busy, at)
        {busy, answers ++ [{at - now, ack}]}

      answered ->
        answered
    end
  end
end
