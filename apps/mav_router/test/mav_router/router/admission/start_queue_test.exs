defmodule MavRouter.Router.Admission.StartQueueTest do
  use ExUnit.Case, async: true

  import :proper_types, only: [list: 1, range: 2]

  alias MavRouter.Router.Admission.StartQueue

  defp all(queue, taken \\ []) do
    case StartQueue.take(queue) do
      nil -> Enum.reverse(taken)
      {key, queue} -> all(queue, [key | taken])
    end
  end

  test "each owner has its turn: one vehicle of another link is next but one behind three hundred" do
    queue = Enum.reduce(1..300, StartQueue.new(), &StartQueue.put(&2, "flooded", {:made_up, &1}))
    assert [{:made_up, 1}, :real, {:made_up, 2} | _] = queue |> StartQueue.put("quiet", :real) |> all()
  end

  test "everybody is taken once, each owner's in their order" do
    property =
      :proper.forall(list(range(1, 4)), fn owners ->
        keys = Enum.with_index(owners)

        taken =
          Enum.reduce(keys, StartQueue.new(), fn {owner, _} = key, queue ->
            StartQueue.put(queue, owner, key)
          end)
          |> all()

        Enum.sort_by(taken, &elem(&1, 1)) == keys and
          Enum.all?(1..4, fn owner ->
            Enum.filter(taken, &(elem(&1, 0) == owner)) == Enum.filter(keys, &(elem(&1, 0) == owner))
          end)
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300]) == true, inspect(:proper.counterexample())
  end
end
