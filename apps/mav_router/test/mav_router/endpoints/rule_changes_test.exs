defmodule MavRouter.Endpoints.RuleChangesTest do
  use ExUnit.Case, async: true

  alias MavRouter.Endpoints.RuleChanges

  test "any input is a rule or an error message, and nothing becomes an atom" do
    for wrong <- [
          %{},
          %{"side" => "client"},
          %{"unheard of" => 1},
          %{"role" => "admin"},
          %{"role" => 7},
          %{"filter_out" => "RAW_IMU"},
          %{"filter_out" => %{"block_messages" => "RAW_IMU"}},
          %{"filter_in" => %{"block_everything" => []}},
          %{"queue_kb" => "much"},
          %{"queue_frames" => 0},
          %{"carry" => "all"},
          %{"networks" => "main"},
          %{"networks" => []},
          %{"sniffer" => "yes"},
          %{"bytes_per_s" => 1.5},
          %{"id_offsets" => [1]}
        ] do
      assert {:error, words} = RuleChanges.parse(wrong)
      assert is_binary(words)
    end

    assert {:ok, %{bytes_per_s: nil, networks: ["a"]}} =
             RuleChanges.parse(%{"bytes_per_s" => nil, "networks" => ["a"]})
  end
end
