defmodule Msp.Test.Simulated do
  @moduledoc "A simulated flight controller at `Msp.Test.Line`: its time is that of the line."

  alias SimVehicle.Msp.Firmware

  @doc "The function that answers, and one that changes the flight controller."
  def controller(firmware, options \\ []) do
    {:ok, agent} = Agent.start_link(fn -> firmware |> Firmware.new(options) |> Firmware.connect(:port) end)

    answer = fn bytes, us ->
      Agent.get_and_update(agent, fn fc ->
        {fc, first} = Firmware.step(fc, max(us - fc.now, 0))
        {fc, second} = Firmware.receive(fc, :port, bytes)
        {fc, third} = Firmware.step(fc, 10_000)
        {for({:port, out} <- first ++ second ++ third, into: <<>>, do: out), fc}
      end)
    end

    {answer, fn change -> Agent.update(agent, change) end, fn -> Agent.get(agent, & &1) end}
  end
end
