defmodule Aerie.Vehicle.SnapshotTest do
  use ExUnit.Case, async: true

  alias Aerie.Vehicle.Snapshot

  @links [
    %{id: "radio", spec: %{recorded: false}, last_heard: 900},
    %{id: "flight", spec: %{recorded: true}, last_heard: 150},
    %{id: "other", spec: %{recorded: true}, last_heard: nil}
  ]

  test "a live vehicle's silence is measured against the clock, and is never negative" do
    assert Snapshot.silent_us(%{last_heard: 900, links: ["radio"]}, @links, 1000) == 100
    assert Snapshot.silent_us(%{last_heard: 1100, links: ["radio"]}, @links, 1000) == 0
    assert Snapshot.silent_us(%{last_heard: 100, links: []}, @links, 1000) == 900
    assert Snapshot.silent_us(%{last_heard: nil, links: ["radio"]}, @links, 1000) == nil
  end

  test "a recorded vehicle's silence is measured against its recording" do
    assert Snapshot.silent_us(%{last_heard: 100, links: ["flight"]}, @links, 1_000_000) == 50
    assert Snapshot.silent_us(%{last_heard: 100, links: ["flight", "other"]}, @links, 1_000_000) == 50
    assert Snapshot.silent_us(%{last_heard: 100, links: ["flight", "radio"]}, @links, 1000) == 900
  end
end
