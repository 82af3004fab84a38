defmodule Aerie.Fleet.Shadow.LeasedCommandsTest do
  @moduledoc """
  Which gateway sends a command: two of them with one bucket, clocks of their own, cuts, restarts and late messages between them. Each
  step of a command is one of the model's, so anything may happen between any two.
  """
  use ExUnit.Case, async: true

  alias Aerie.Control.Commands.Gateways.Sending
  alias Aerie.Fleet.Shadow.GatewayLease

  @ttl 10_000

  test "no command is sent twice, none by a gateway without the lease, and once all is well each arrives" do
    gateway = :proper_types.integer(0, 1)
    ms = :proper_types.oneof([:proper_types.integer(1, 200), :proper_types.integer(100, 6_000)])

    what =
      :proper_types.frequency([
        {8, :run},
        {12, :step},
        {6, {:give, :proper_types.integer(1, 4)}},
        {3, :mail},
        {1, :cut},
        {2, :join},
        {1, :half_cut},
        {1, :restart},
        {1, :deaf}
      ])

    property =
      :proper.forall(:proper_types.list(:proper_types.tuple([gateway, what, ms])), fn steps ->
        world = Enum.reduce(steps, world(), &step/2)
        calm = for _round <- 1..40, n <- 0..1, what <- [:join, :hear], do: {n, what, 400}
        world = Enum.reduce(calm, world, &step/2)

        given = [
          {0, {:give, :new0}, 1},
          {1, {:give, :new1}, 1},
          {0, {:give, :both}, 1},
          {1, {:give, :both}, 1}
        ]

        world = Enum.reduce(given, world, &step/2)
        rounds = for _round <- 1..60, n <- 0..1, what <- [:run, :step, :mail], do: {n, what, 20}
        world = Enum.reduce(rounds, world, &step/2)
        world.ok? and Enum.all?([:new0, :new1, :both], &is_map_key(world.sent, &1))
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 600, max_size: 80]) == true,
           inspect(:proper.counterexample())
  end

  defp world do
    gateways = %{0 => gateway(0, 5_000_000), 1 => gateway(1, -70_000)}

    %{
      now: 0,
      gateways: gateways,
      bucket: %{owner: nil, renewals: %{}, claims: %{}},
      mail: [],
      sent: %{},
      ok?: true
    }
  end

  defp gateway(n, offset) do
    lease = GatewayLease.new("g#{n}", @ttl) |> GatewayLease.want("V", true)
    %{n: n, lease: lease, offset: offset, cut: :no, hears?: true, seen: %{}, ledger: %{}, jobs: []}
  end

  defp step({n, what, ms}, world) do
    world = %{world | now: world.now + ms}
    gateway = world.gateways[n]
    act(what, gateway, world)
  end

  defp act(:cut, gateway, world), do: put(world, %{gateway | cut: :yes})
  # What it writes arrives, and the answer is lost.
  defp act(:half_cut, gateway, world), do: put(world, %{gateway | cut: :answers})
  defp act(:join, gateway, world), do: act(:run, %{gateway | cut: :no}, world)
  defp act(:hear, gateway, world), do: put(world, hears(gateway, true))

  # It no longer hears the vehicle, and gives it up.
  defp act(:deaf, %{cut: cut} = gateway, world) do
    me = gateway.lease.me
    bucket = if world.bucket.owner == me and cut == :no, do: %{world.bucket | owner: nil}, else: world.bucket
    gateway = hears(gateway, false)
    lease = GatewayLease.owner(gateway.lease, "V", nil, now(gateway, world))
    put(%{world | bucket: bucket}, %{gateway | lease: lease})
  end

  # Its ledger is on the disk. What may have been sent is never sent again.
  defp act(:restart, gateway, world) do
    new = gateway(gateway.n, gateway.offset)
    ledger = Map.reject(gateway.ledger, fn {_id, state} -> state == :admitted end)
    put(world, %{new | cut: gateway.cut, ledger: ledger})
  end

  defp act(:run, %{cut: :yes}, world), do: world

  defp act(:run, gateway, world) do
    {gateway, bucket} = renew(gateway, world.bucket, now(gateway, world))
    put(%{world | bucket: bucket}, gateway)
  end

  defp act({:give, id}, gateway, world), do: put(world, given(gateway, id, false, world))

  defp act(:mail, %{cut: :no} = gateway, world) do
    {mine, others} = Enum.split_with(world.mail, fn {to, _id} -> to == gateway.lease.me end)
    gateway = Enum.reduce(mine, gateway, fn {_to, id}, gateway -> given(gateway, id, true, world) end)
    put(%{world | mail: others}, gateway)
  end

  defp act(:mail, _gateway, world), do: world
  defp act(:step, %{jobs: []}, world), do: world

  defp act(:step, %{jobs: [{id, holding} | jobs]} = gateway, world) do
    now = now(gateway, world)
    gateway = %{gateway | jobs: jobs}

    {holding, action} = Sending.handle(holding, {:holder, holder(gateway, now), now})
    done(action, id, holding, gateway, world)
  end

  defp hears(gateway, hears?),
    do: %{gateway | hears?: hears?, lease: GatewayLease.want(gateway.lease, "V", hears?)}

  defp given(gateway, id, relayed?, world) do
    if is_map_key(gateway.ledger, id) or List.keymember?(gateway.jobs, id, 0),
      do: gateway,
      else: %{gateway | jobs: gateway.jobs ++ [{id, Sending.new(now(gateway, world) + 500, relayed?)}]}
  end

  defp done({:again, _ms}, id, holding, gateway, world), do: put(world, later(gateway, id, holding))

  defp done(:go_on, id, holding, gateway, world),
    do: put(world, later(ledger(gateway, id, :admitted), id, holding))

  defp done({:pass_on, name}, id, _holding, gateway, world) do
    mail = if gateway.cut == :no, do: [{name, id} | world.mail], else: world.mail
    put(%{world | mail: mail}, ledger(gateway, id, :passed_on))
  end

  defp done(:claim, id, holding, gateway, world) do
    {claimed, bucket} = claim(gateway, id, world.bucket)

    case Sending.handle(holding, {:claimed, claimed}) do
      # From here on the ledger says that it may have been sent.
      {holding, :go_on} ->
        put(%{world | bucket: bucket}, later(ledger(gateway, id, :sending), id, holding))

      {_over, _known_or_refused} ->
        put(%{world | bucket: bucket}, ledger(gateway, id, :done))
    end
  end

  defp done({:send, :fleet}, id, _holding, gateway, world) do
    others = for {m, other} <- world.gateways, m != gateway.n, holds?(other, world), do: m
    ok? = world.ok? and not is_map_key(world.sent, id) and others == [] and holds?(gateway, world)
    put(%{world | sent: Map.put(world.sent, id, gateway.n), ok?: ok?}, ledger(gateway, id, :done))
  end

  # Before it was admitted a refusal is not kept.
  defp done({:refuse, _denial}, id, _holding, gateway, world) do
    admitted? = is_map_key(gateway.ledger, id)
    put(world, if(admitted?, do: ledger(gateway, id, :done), else: gateway))
  end

  defp claim(%{cut: :yes}, _id, bucket), do: {{:error, "cut off"}, bucket}

  defp claim(gateway, id, bucket) do
    me = gateway.lease.me

    {answer, bucket} =
      case bucket.claims do
        %{^id => ^me} -> {:ok, bucket}
        %{^id => _other} -> {{:taken, :them}, bucket}
        _none -> {:ok, put_in(bucket.claims[id], me)}
      end

    if gateway.cut == :answers, do: {{:error, "no answer"}, bucket}, else: {answer, bucket}
  end

  defp holder(gateway, now) do
    case GatewayLease.holder(gateway.lease, "V", now) do
      :none -> {:unknown, "nobody knows"}
      known -> known
    end
  end

  defp holds?(gateway, world), do: match?({:mine, _until}, holder(gateway, now(gateway, world)))
  defp later(gateway, id, holding), do: %{gateway | jobs: gateway.jobs ++ [{id, holding}]}
  defp ledger(gateway, id, state), do: put_in(gateway.ledger[id], state)
  defp put(world, gateway), do: put_in(world.gateways[gateway.n], gateway)
  defp now(gateway, world), do: world.now + gateway.offset

  defp renew(gateway, bucket, now) do
    # Only news count as a sign of life.
    news = for {id, count} <- bucket.renewals, gateway.seen[id] != count, do: id
    lease = Enum.reduce(news, gateway.lease, &GatewayLease.peer(&2, &1, now))
    lease = if bucket.owner == lease.me, do: lease, else: GatewayLease.owner(lease, "V", bucket.owner, now)
    bucket = %{bucket | renewals: Map.update(bucket.renewals, lease.me, 1, &(&1 + 1))}

    if gateway.cut == :answers,
      do: {%{gateway | lease: lease}, bucket},
      else: take(gateway, lease, bucket, now)
  end

  defp take(gateway, lease, bucket, now) do
    lease = GatewayLease.renewed(lease, now)

    {lease, bucket} =
      case GatewayLease.claims(lease, now) do
        ["V"] ->
          if bucket.owner in [nil, lease.me] or GatewayLease.gone?(lease, bucket.owner, now),
            do: {GatewayLease.owner(lease, "V", lease.me, now), %{bucket | owner: lease.me}},
            else: {GatewayLease.owner(lease, "V", bucket.owner, now), bucket}

        [] ->
          {lease, bucket}
      end

    {%{gateway | lease: lease, seen: bucket.renewals}, bucket}
  end
end
