defmodule Aerie.Access.LimiterTest do
  use ExUnit.Case, async: true

  alias Aerie.Access.Limiter

  test "delayed attempts are answered in their time, and only so many wait" do
    gateway = make_ref()
    start_supervised!({Limiter, gateway: gateway, now: fn -> 0 end})

    for n <- 1..11 do
      {:ok, false} = Limiter.try(gateway, {10, 0, 0, n}, "admin")
      Limiter.outcome(gateway, {10, 0, 0, n}, "admin", :wrong)
    end

    tries = for n <- 1..100, do: Task.async(fn -> Limiter.try(gateway, {10, 0, 1, n}, "admin") end)
    answers = Task.await_many(tries, Aerie.Patience.ms())
    assert Enum.frequencies(answers) |> Map.keys() |> Enum.sort() == Enum.sort([{:ok, false}, {:wait, 5}])
    # This machine does not wait behind them.
    assert {:ok, true} = Limiter.try(gateway, {127, 0, 0, 1}, "admin")
  end
end
