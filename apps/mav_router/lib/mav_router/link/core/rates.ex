defmodule MavRouter.Link.Core.Rates do
  @moduledoc """
  Rates per second from counters: the samples of the last second, as a value.
  """

  alias MavRouter.Link.Core.Counters

  @names [:bytes_in, :frames_in, :bytes_out, :writes_out, :crc_errors]
  @window_ms 1000

  defstruct samples: []

  @opaque t :: %__MODULE__{samples: [{integer, map}]}

  @doc "No samples yet: all rates are 0."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "Adds the counters at a monotonic time in ms. The sample at or just before the window's start is kept."
  @spec sample(t, Counters.t(), integer) :: t
  def sample(%__MODULE__{samples: samples}, counters, now) do
    {inside, before} = Enum.split_while(samples, fn {time, _} -> now - time < @window_ms end)
    %__MODULE__{samples: [{now, Map.take(counters, @names)} | inside ++ Enum.take(before, 1)]}
  end

  @doc "Whether any rate is above 0."
  @spec any?(t) :: boolean
  def any?(%__MODULE__{samples: [{_now, newest} | _] = samples}), do: elem(List.last(samples), 1) != newest
  def any?(%__MODULE__{samples: []}), do: false

  @doc "Rates per second over about the last second: #{Enum.map_join(@names, ", ", &"`#{&1}`")}."
  @spec per_second(t) :: %{atom => float}
  def per_second(%__MODULE__{samples: [{now, newest} | _] = samples}) do
    {then, oldest} = List.last(samples)
    tenths = 10_000 / max(now - then, 1)
    Map.new(newest, fn {name, n} -> {name, round((n - Map.fetch!(oldest, name)) * tenths) / 10} end)
  end

  def per_second(%__MODULE__{samples: []}), do: Map.new(@names, &{&1, 0.0})
end
