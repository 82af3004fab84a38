defmodule MavRouter.Endpoints.Owner.RateLimit do
  @moduledoc """
  How often a message may go out to an endpoint, counted for each component that sends it, so that the positions of ten vehicles do
  not share one allowance.

  Each stream has one value, the time at which its next frame is due. A frame may pass half an interval early, since no source is
  perfectly regular, but over any time no more than the rate (and one frame) passes.
  """

  alias Aerie.Base.Json
  alias MavRouter.Endpoints.Owner.Filter

  @typedoc "Intervals in microseconds by message id."
  @type t :: %{non_neg_integer => pos_integer} | nil

  @doc """
  Compiles `%{"ATTITUDE" => 4.0}` (messages by name or id, rates in Hz, above 0 and up to 10,000; 0 stops a message);
  the error is a text.
  """
  @spec compile(%{optional(String.t() | non_neg_integer) => number} | nil) :: {:ok, t} | {:error, String.t()}
  def compile(empty) when empty in [nil, %{}], do: {:ok, nil}

  def compile(rates) when is_map(rates) do
    Enum.reduce_while(rates, {:ok, %{}}, fn {message, hz}, {:ok, done} ->
      with {:id, {:ok, id}} <- {:id, Filter.message(message)},
           {:once, false} <- {:once, is_map_key(done, id)},
           {:hz, true} <- {:hz, is_number(hz) and hz >= 0 and hz <= 10_000} do
        {:cont, {:ok, Map.put(done, id, interval(hz))}}
      else
        {:id, :error} -> {:halt, {:error, "#{Json.shown(message, 60)} is not a message"}}
        {:once, true} -> {:halt, {:error, "#{Json.shown(message, 60)} has two rates, by its name or id"}}
        {:hz, false} -> {:halt, {:error, "#{Json.shown(hz, 60)} is not a rate (0 to 10000 a second)"}}
      end
    end)
  end

  def compile(other),
    do: {:error, "rate limits are a map of messages to rates, not #{Json.shown(other, 60)}"}

  # Once in 30 years is never.
  defp interval(hz) when hz == 0, do: 1_000_000_000_000_000
  defp interval(hz), do: max(round(1_000_000 / hz), 1)

  @doc "Whether a frame passes at `now` (monotonic microseconds) when the next is `due`, nil before the first one."
  @spec pass(integer | nil, pos_integer, integer) :: {:pass, due :: integer} | :drop
  def pass(nil, interval, now), do: {:pass, now + interval}

  def pass(due, interval, now) do
    cond do
      now >= due -> {:pass, now + interval}
      now >= due - div(interval, 2) -> {:pass, due + interval}
      true -> :drop
    end
  end
end
