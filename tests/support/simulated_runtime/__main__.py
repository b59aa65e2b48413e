import sys, time, traceback
from collections import Counter
from simulated_runtime.plan import draw
from simulated_runtime import simulation
from simulated_runtime.simulation import simulate
a,b=map(int,sys.argv[1:3])
n=0; t=time.time(); c=time.process_time(); ends=Counter(); st=Counter(); bad=0
for seed in range(a,b):
    p=draw(seed)
    try:
        r=simulate(p)
        n+=r.packets; ends[r.ending[:60]]+=1; st.update(r.statuses)
    except BaseException as e:
        bad+=1
        print("SEED",seed,repr(e)[:400])
        if len(sys.argv)>3:
            print(p); traceback.print_exc(limit=-3)
            for cmd,shot in simulation.LAST._ledger.commands: print(shot, cmd)
        if bad>12: break
dt=time.time()-t; c=time.process_time()-c
print(n,"packets", dt,"s", n/dt*60,"per minute", n/c*60, "per minute of processor"); print(ends); print(st)
