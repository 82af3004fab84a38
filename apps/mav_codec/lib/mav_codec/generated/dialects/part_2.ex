defmodule MavCodec.Generated.Dialects.Part2 do
  use MavCodec.Definition.Shard, dialects: {2, 4}
end
