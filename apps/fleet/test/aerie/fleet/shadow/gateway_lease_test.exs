defmodule Aerie.Fleet.Shadow.GatewayLeaseTest do
  @moduledoc "Which gateway acts: two and three of them with one bucket, clocks of their own, and cuts between them."
  use ExUnit.Case, async: true

  alias Aerie.Fleet.Shadow.GatewayLease

  @ttl 10_000

  test "one acts after it has renewed and claimed; another one waits until it is gone, and half as long again" do
    lease = GatewayLease.new("a", @ttl) |> GatewayLease.want("V", true)
    assert GatewayLease.claims(lease, 0) == []
    lease = GatewayLease.renewed(lease, 0)
    assert GatewayLease.claims(lease, 1) == ["V"]
    lease = GatewayLease.owner(lease, "V", "a", 1)
    assert GatewayLease.claims(lease, 1) == []
    assert GatewayLease.holder(lease, "V", 9_999) == {:mine, @ttl}
    assert GatewayLease.holder(lease, "V", @ttl) == :none

    other =
      GatewayLease.new("b", @ttl)
      |> GatewayLease.want("V", true)
      |> GatewayLease.renewed(0)
      |> GatewayLease.peer("a", 0)
      |> GatewayLease.owner("V", "a", 0)

    other = other |> GatewayLease.renewed(7_500) |> GatewayLease.renewed(15_000)
    assert GatewayLease.claims(other, 15_000) == []
    assert GatewayLease.holder(other, "V", 15_000) == {:other, "a"}
    assert GatewayLease.claims(other, 15_001) == ["V"]
    assert GatewayLease.claims(GatewayLease.peer(other, "a", 15_001), 15_002) == []
  end

  test "it is alone once none of the others can act by what it saw before" do
    lease = GatewayLease.new("a", @ttl)
    assert GatewayLease.alone?(lease, 0)
    lease = GatewayLease.peer(lease, "b", 0)
    refute GatewayLease.alone?(lease, 3 * @ttl)
    assert GatewayLease.alone?(lease, 3 * @ttl + 1)
    # An owner that was never heard may be there.
    wanted = "a" |> GatewayLease.new(@ttl) |> GatewayLease.want("V", true)
    refute wanted |> GatewayLease.owner("V", "b", 0) |> GatewayLease.alone?(1)
    # So short that a first write may come too late.
    refute "a" |> GatewayLease.new(3_000) |> GatewayLease.alone?(0)
  end

  test "after a gap it owns nothing until the bucket says so" do
    lease =
      GatewayLease.new("a", @ttl)
      |> GatewayLease.want("V", true)
      |> GatewayLease.renewed(0)
      |> GatewayLease.owner("V", "a", 0)

    assert {:mine, _until} = lease |> GatewayLease.renewed(9_000) |> GatewayLease.holder("V", 9_001)
    late = GatewayLease.renewed(lease, 10_000)
    assert GatewayLease.holder(late, "V", 10_001) == :none
    assert GatewayLease.claims(late, 10_001) == ["V"]
    # It saw nothing of the others in that time.
    refute lease
           |> GatewayLease.peer("b", 0)
           |> GatewayLease.renewed(30_000)
           |> GatewayLease.gone?("b", 30_001)
  end

  test "what the bucket said of owners is forgotten with it, and has to be claimed again" do
    lease =
      GatewayLease.new("a", @ttl)
      |> GatewayLease.want("V", true)
      |> GatewayLease.renewed(0)
      |> GatewayLease.owner("V", "a", 0)

    forgotten = GatewayLease.forget(lease)
    assert {GatewayLease.holder(forgotten, "V", 1), GatewayLease.claims(forgotten, 1)} == {:none, ["V"]}
  end

  test "an owner that was never seen to renew gets the full time" do
    lease =
      GatewayLease.new("b", @ttl)
      |> GatewayLease.want("V", true)
      |> GatewayLease.renewed(0)
      |> GatewayLease.owner("V", "a", 0)

    assert GatewayLease.claims(lease, 9_000) == []
    assert GatewayLease.claims(GatewayLease.renewed(lease, 9_000), 15_001) == ["V"]
  end

  test "a gateway that does not hear the vehicle claims nothing, and of very many gateways some are forgotten" do
    lease =
      GatewayLease.new("a", @ttl)
      |> GatewayLease.want("V", true)
      |> GatewayLease.want("V", false)
      |> GatewayLease.renewed(0)

    assert GatewayLease.claims(lease, 1) == []
    many = Enum.reduce(1..1_000, lease, &GatewayLease.peer(&2, "p#{&1}", &1))
    assert map_size(many.peers) <= 256
  end

  # Gateways before one bucket: each step lets one of them renew, claim, be cut off, or hear of the bucket late.
  test "never do two act at once, whatever is cut and delayed, and somebody acts in the end" do
    step =
      :proper_types.tuple([
        :proper_types.integer(0, 2),
        :proper_types.oneof([:run, :run, :run, :cut, :join]),
        :proper_types.integer(100, 4_000)
      ])

    property =
      :proper.forall(:proper_types.list(step), fn steps ->
        clocks = [0, 5_000_000, -70_000]
        gateways = for {offset, n} <- Enum.with_index(clocks), into: %{}, do: {n, gateway(n, offset)}
        world = %{now: 0, gateways: gateways, bucket: %{owner: nil, renewals: %{}}, ok?: true}
        world = Enum.reduce(steps, world, &step/2)
        calm = for _round <- 1..30, n <- 0..2, do: {n, :join, 400}
        world = Enum.reduce(calm ++ for(_round <- 1..30, n <- 0..2, do: {n, :run, 400}), world, &step/2)
        world.ok? and length(acting(world)) == 1
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 200]) == true, inspect(:proper.counterexample())
  end

  defp gateway(n, offset),
    do: %{
      lease: GatewayLease.new("g#{n}", @ttl) |> GatewayLease.want("V", true),
      offset: offset,
      cut?: false,
      seen: %{}
    }

  defp step({n, what, ms}, world) do
    world = %{world | now: world.now + ms}
    gateway = world.gateways[n]

    {gateway, bucket} =
      case what do
        :cut -> {%{gateway | cut?: true}, world.bucket}
        :join -> run(%{gateway | cut?: false}, world.bucket, world.now)
        :run when gateway.cut? -> {gateway, world.bucket}
        :run -> run(gateway, world.bucket, world.now)
      end

    world = %{world | gateways: Map.put(world.gateways, n, gateway), bucket: bucket}
    %{world | ok?: world.ok? and length(acting(world)) <= 1}
  end

  defp run(gateway, bucket, at) do
    now = at + gateway.offset
    # Only news count as a sign of life.
    news = for {id, count} <- bucket.renewals, gateway.seen[id] != count, do: id
    lease = Enum.reduce(news, gateway.lease, &GatewayLease.peer(&2, &1, now))

    lease =
      if bucket.owner in [nil, lease.me], do: lease, else: GatewayLease.owner(lease, "V", bucket.owner, now)

    lease = GatewayLease.renewed(lease, now)
    bucket = %{bucket | renewals: Map.update(bucket.renewals, lease.me, 1, &(&1 + 1))}

    {lease, bucket} =
      case GatewayLease.claims(lease, now) do
        [] -> {lease, bucket}
        ["V"] -> claim(lease, bucket, now)
      end

    {%{gateway | lease: lease, seen: bucket.renewals}, bucket}
  end

  defp claim(%{me: me} = lease, %{owner: owner} = bucket, now) do
    if owner in [nil, me] or GatewayLease.gone?(lease, owner, now),
      do: {GatewayLease.owner(lease, "V", me, now), %{bucket | owner: me}},
      else: {GatewayLease.owner(lease, "V", owner, now), bucket}
  end

  defp acting(world) do
    for {n, gateway} <- world.gateways,
        match?({:mine, _until}, GatewayLease.holder(gateway.lease, "V", world.now + gateway.offset)),
        do: n
  end
end
